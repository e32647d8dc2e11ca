// What the solver needs to know of a voxel model: plain arrays, no material or tissue names.
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace tledface {

struct VoxelMuscle {
  std::string name;
  std::vector<std::int64_t> elements;   // indices into cells
  std::vector<double> fibre;            // 3 per element, unit vectors in the reference frame
  std::vector<double> weight;           // overlap fraction, 0…1
  double sigma_act = 0, sigma_pas = 0;  // Pa
  double lambda_opt = 1, lambda_pas = 1.2;
  bool calcium = false;          // the calcium law instead of tension over length
  double beta = 0;               // of the calcium law
  bool printed_passive = false;  // the paper's law with its jump at lambda_pas
};

// One constitutive law over some elements, besides the base part (kernels_cl/base.cl).
struct VoxelLaw {
  std::string name;
  std::vector<std::int64_t> elements;  // each at most once
  std::vector<double> rows;            // per element the law's rows: weight, then its values
};

struct VoxelModel {
  std::array<double, 3> voxel{};       // m
  std::vector<std::int32_t> cells;     // 3 per element, grid indices >= 0
  std::vector<std::int32_t> node_ijk;  // 3 per node, grid indices >= 0
  // Per element; Pa, Pa, Pa, kg/m3.
  // mu: of the neo-Hookean base; shear_modulus and bulk_modulus: of all laws at rest.
  std::vector<double> mu, bulk_log, bulk_quadratic, density, shear_modulus, bulk_modulus;
  std::vector<VoxelLaw> laws;
  std::vector<double> bending_modulus;  // 3 per element, Pa: section normal to x, y, z
  std::vector<std::uint8_t> fixed;      // 3 per node
  std::array<double, 3> gravity{};      // m/s2
  std::vector<VoxelMuscle> muscles;

  std::size_t n_elements() const { return cells.size() / 3; }
  std::size_t n_nodes() const { return node_ijk.size() / 3; }
};

}  // namespace tledface
