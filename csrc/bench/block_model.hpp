// The flat skin block of the benchmark: layers and muscle of Warburton & Maddock's Table I
// on a plain grid, density scaled by ten as there.
#pragma once
#include <algorithm>
#include <cmath>
#include <utility>

#include "precompute/voxel_model.hpp"

namespace tledface::bench {

struct Tissue {
  double youngs_modulus, poissons_ratio;
};

constexpr double kVoxel = 0.5e-3;  // m
constexpr Tissue kCorneum{48e6, .49}, kDermis{0.0814e6, .49}, kHypodermis{0.034e6, .49},
    kMuscle{0.5e6, .49};

// Moduli of a mix, by parts.
struct Moduli {
  double mu = 0, bulk = 0;
  Moduli& add(double share, const Tissue& t) {
    mu += share * t.youngs_modulus / (2 * (1 + t.poissons_ratio));
    bulk += share * t.youngs_modulus / (3 * (1 - 2 * t.poissons_ratio));
    return *this;
  }
};

inline VoxelMuscle frontalis() {
  VoxelMuscle muscle;
  muscle.name = "frontalis";
  muscle.sigma_act = muscle.sigma_pas = 5e6;
  return muscle;
}

inline void add_fibre(VoxelMuscle& muscle, std::size_t element, double x, double y, double z) {
  muscle.elements.push_back(static_cast<std::int64_t>(element));
  muscle.fibre.insert(muscle.fibre.end(), {x, y, z});
  muscle.weight.push_back(1);
}

inline void reserve(VoxelModel& model, std::size_t n_elements) {
  model.cells.reserve(3 * n_elements);
  model.bending_modulus.reserve(3 * n_elements);
  for (auto* values : {&model.mu, &model.bulk_log, &model.bulk_quadratic, &model.shear_modulus,
                       &model.bulk_modulus, &model.density})
    values->reserve(n_elements);
}

inline void add_element(VoxelModel& model, int i, int j, int k, const Moduli& m, double density) {
  model.cells.insert(model.cells.end(), {i, j, k});
  model.mu.push_back(m.mu);
  model.bulk_log.push_back(m.bulk);
  model.bulk_quadratic.push_back(0);
  model.shear_modulus.push_back(m.mu);
  model.bulk_modulus.push_back(m.bulk);
  model.density.push_back(density);
  const double youngs = 9 * m.bulk * m.mu / (3 * m.bulk + m.mu);
  for (int c = 0; c < 3; ++c) model.bending_modulus.push_back(youngs);
}

// nx x ny x nz voxels of 0.5 mm. Top layer: corneum (4 % of 48 MPa) in dermis; 1.8 mm dermis; rest
// hypodermis; a muscle sheet two voxels thick above the bottom one, over the middle 60 % in x.
inline VoxelModel flat_block(int nx, int ny, int nz, bool with_muscle) {
  VoxelModel model;
  model.voxel = {kVoxel, kVoxel, kVoxel};
  reserve(model, std::size_t(nx) * ny * nz);
  VoxelMuscle muscle = frontalis();
  for (int k = 0; k < nz; ++k) {
    const double top = (nz - 1 - k) * kVoxel;  // depth of the voxel's upper face
    const double thin = k == nz - 1 ? 0.04 : 0;
    const double in_dermis = std::fmin(1, std::fmax(0, (1.82e-3 - top) / kVoxel)) - thin;
    const Moduli layers =
        Moduli().add(thin, kCorneum).add(in_dermis, kDermis).add(1 - thin - in_dermis, kHypodermis);
    for (int j = 0; j < ny; ++j)
      for (int i = 0; i < nx; ++i) {
        const bool in_muscle = with_muscle && (k == 1 || k == 2) && i >= nx / 5 && i < nx - nx / 5;
        if (in_muscle) add_fibre(muscle, model.n_elements(), 1, 0, 0);
        add_element(model, i, j, k, in_muscle ? Moduli().add(1, kMuscle) : layers, 11000);
      }
  }
  const std::size_t n_nodes = std::size_t(nx + 1) * (ny + 1) * (nz + 1);
  model.node_ijk.reserve(3 * n_nodes);
  model.fixed.reserve(3 * n_nodes);
  for (int k = 0; k <= nz; ++k)
    for (int j = 0; j <= ny; ++j)
      for (int i = 0; i <= nx; ++i) {
        model.node_ijk.insert(model.node_ijk.end(), {i, j, k});
        const bool end = i == 0 || i == nx;
        for (const bool held : {end, end, end || k == 0}) model.fixed.push_back(held);
      }
  if (with_muscle) model.muscles.push_back(std::move(muscle));
  return model;
}

// Half of the elements take Mooney-Rivlin in place of neo-Hookean, of the same stiffness at rest:
// all of one side ("sorted": blocks hold one law) or every other one at random ("scattered": every
// block computes both). The two cost the same flops an element; their difference is what uniform
// blocks are worth.
inline void mix_laws(VoxelModel& model, bool scattered) {
  VoxelLaw law;
  law.name = "mooney_rivlin";
  std::int32_t widest = 0;
  for (std::size_t i = 0; i < model.cells.size(); i += 3) widest = std::max(widest, model.cells[i]);
  std::uint32_t random = 1;
  for (std::size_t e = 0; e < model.n_elements(); ++e) {
    random = random * 1664525u + 1013904223u;
    if (scattered ? (random >> 16) % 2 == 0 : model.cells[3 * e] <= widest / 2) continue;
    law.elements.push_back(static_cast<std::int64_t>(e));
    // weight, c10, c01, c11, c20, c30
    law.rows.insert(law.rows.end(), {1, model.mu[e] * 0.4, model.mu[e] * 0.1, 0, 0, 0});
    model.mu[e] = 0;
  }
  model.laws.push_back(law);
}

}  // namespace tledface::bench
