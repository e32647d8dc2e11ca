// What the solver needs to know of a model: plain arrays, no material or tissue names. Elements are
// voxels of a regular grid, or, where `hexahedra` is not empty, hexahedra of a conforming mesh.
#pragma once
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "precompute/hexahedron.hpp"

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
  // Of a conforming mesh instead of the three above; see set_hexahedra.
  std::vector<double> positions;      // 3 per node, m
  std::vector<std::int32_t> corners;  // 8 per element; corner bits: 1 along xi, 2 eta, 4 zeta
  std::vector<Hexahedron> hexahedra;
  // Per element; Pa, Pa, Pa, kg/m3.
  // mu: of the neo-Hookean base; shear_modulus and bulk_modulus: of all laws at rest.
  std::vector<double> mu, bulk_log, bulk_quadratic, density, shear_modulus, bulk_modulus;
  std::vector<VoxelLaw> laws;
  std::vector<double> bending_modulus;  // 3 per element, Pa: section normal to x, y, z (xi, …)
  std::vector<std::uint8_t> fixed;      // 3 per node
  std::array<double, 3> gravity{};      // m/s2
  std::vector<VoxelMuscle> muscles;

  bool conforming() const { return !hexahedra.empty(); }
  std::size_t n_elements() const { return conforming() ? hexahedra.size() : cells.size() / 3; }
  std::size_t n_nodes() const { return (conforming() ? positions.size() : node_ijk.size()) / 3; }
  double element_volume(std::size_t e) const {
    return conforming() ? hexahedra[e].volume : voxel[0] * voxel[1] * voxel[2];
  }
  double shortest_edge() const;
  // Of a node, from the grid's origin, m.
  std::array<double, 3> position(std::size_t node) const {
    if (conforming())
      return {positions[3 * node], positions[3 * node + 1], positions[3 * node + 2]};
    return {node_ijk[3 * node] * voxel[0], node_ijk[3 * node + 1] * voxel[1],
            node_ijk[3 * node + 2] * voxel[2]};
  }
  // From one node to another; equal ways between voxels are the same bits.
  std::array<double, 3> way(std::size_t from, std::size_t to) const;
};

// Makes `model` a conforming mesh of these hexahedra and finds their geometry; moduli are there
// already. Throws InputError for a corner that does not exist, a position that is not finite, an
// element that is inside out or degenerate.
void set_hexahedra(VoxelModel& model, std::vector<double> positions,
                   std::vector<std::int32_t> corners);

// Their stiffening (hexahedron.hpp) with the kappa form instead of the physical one.
void set_kappa_stiffening(VoxelModel& model, double kappa);

}  // namespace tledface
