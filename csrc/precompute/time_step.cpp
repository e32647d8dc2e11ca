#include "precompute/time_step.hpp"

#include <algorithm>
#include <cmath>

#include "core/threads.hpp"
#include "precompute/layout.hpp"

namespace tledface {
namespace {

// Largest slope of stretch * f_act(stretch) (at stretch 2/3 lambda_opt: 3.083), which the active
// stress reaches on its ascending limb.
constexpr double kActiveSlope = 37.0 / 12.0;
// Elements or blocks that one work-item takes.
constexpr std::size_t kChunk = 4096;

// Slope of stretch * f_pas(stretch) where the exponential ends; the line is steeper only beyond
// stretches of 1.4.
double steepest_passive_slope(double lambda_pas) {
  const double e = std::exp(6.6 * (lambda_pas - 1));
  return std::max(0.05 * (e - 1) + lambda_pas * 0.33 * e, 4.36 * 1.4 - 2.47);
}

std::array<double, 3> inverse_squares(const VoxelModel& model) {
  const auto& h = model.voxel;
  return {1 / (h[0] * h[0]), 1 / (h[1] * h[1]), 1 / (h[2] * h[2])};
}

}  // namespace

std::vector<double> tissue_stiffness(const VoxelModel& model) {
  const auto inverse_square = inverse_squares(model);
  const double of_box = inverse_square[0] + inverse_square[1] + inverse_square[2];
  const double largest = *std::max_element(inverse_square.begin(), inverse_square.end());
  std::vector<double> stiffness(model.n_elements());
  parallel_for_chunks(stiffness.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t e = begin; e < end; ++e) {
      const double bulk = model.bulk_modulus[e], mu = model.shear_modulus[e];
      const double lambda = bulk - 2 * mu / 3;
      stiffness[e] = model.conforming() ? model.hexahedra[e].stiffening *
                                              linear_stiffness(model.hexahedra[e], lambda, mu)
                                        : lambda * of_box + 2 * mu * largest;
    }
  });
  return stiffness;
}

std::vector<double> element_stiffness(const VoxelModel& model, const std::vector<double>& growth) {
  auto stiffness = tissue_stiffness(model);
  for (std::size_t e = 0; e < growth.size(); ++e) stiffness[e] *= std::max(growth[e], 1.0);
  const auto inverse_square = inverse_squares(model);
  for (const VoxelMuscle& muscle : model.muscles) {
    const double steepest = muscle.sigma_act * kActiveSlope +
                            muscle.sigma_pas * steepest_passive_slope(muscle.lambda_pas);
    // An element is once in a muscle.
    const auto add = [&](std::size_t i) {
      const double* d = &muscle.fibre[3 * i];
      double along = 0;
      if (model.conforming()) {  // 2 d.G d in place of the sum over 1/h^2
        const auto G = model.hexahedra[muscle.elements[i]].gradient_square();
        along = 2 * (G[0] * d[0] * d[0] + G[1] * d[1] * d[1] + G[2] * d[2] * d[2]) +
                4 * (G[3] * d[0] * d[1] + G[4] * d[1] * d[2] + G[5] * d[0] * d[2]);
      } else {
        for (int c = 0; c < 3; ++c) along += d[c] * d[c] * inverse_square[c];
      }
      stiffness[muscle.elements[i]] += muscle.weight[i] * steepest * along;
    };
    parallel_for_chunks(muscle.elements.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) add(i);
    });
  }
  return stiffness;
}

std::vector<double> node_stiffness(const VoxelModel& model, const SolverArrays& arrays,
                                   const std::vector<double>& stiffness) {
  const std::size_t lanes = arrays.lanes, n_slots = std::size_t(arrays.n_blocks + 1) * lanes;
  const auto share = [&](std::size_t e) { return stiffness[e] * model.element_volume(e) / 2; };
  std::vector<double> at_slot(n_slots, 0.0);
  if (model.conforming()) {
    for (std::size_t e = 0; e < stiffness.size(); ++e)
      for (int corner = 0; corner < 8; ++corner) at_slot[arrays.corner_slot(e, corner)] += share(e);
  } else {
    // Nodes gather, in one order: of four rows of lanes, those at their own place and before.
    std::vector<double> of_element(n_slots, 0.0);
    parallel_for_chunks(stiffness.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      for (std::size_t e = begin; e < end; ++e) of_element[arrays.element_slot[e]] = share(e);
    });
    const auto link = [&](std::size_t block, int which) {
      return std::size_t(arrays.blocks[block * TLED_BLOCK_INTS + which]);
    };
    const std::size_t width = arrays.width, last = lanes - width;  // of the last row in y
    parallel_for_chunks(arrays.n_blocks, kChunk / lanes, [&](std::size_t begin, std::size_t end) {
      for (std::size_t b = begin; b < end; ++b) {
        const std::size_t below = link(b, BLOCK_PREV_Z), before_y = link(b, BLOCK_PREV_Y),
                          below_before = link(before_y, BLOCK_PREV_Z);
        const auto add_row = [&](double* nodes, std::size_t block, std::size_t first) {
          const double* elements = &of_element[block * lanes + first];
          nodes[0] +=
              elements[0] + of_element[link(block, BLOCK_PREV_X) * lanes + first + width - 1];
          for (std::size_t l = 1; l < width; ++l) nodes[l] += elements[l] + elements[l - 1];
        };
        for (std::size_t first = 0; first < lanes; first += width) {
          double* nodes = &at_slot[b * lanes + first];
          add_row(nodes, b, first);
          add_row(nodes, first ? b : before_y, first ? first - width : last);
          add_row(nodes, below, first);
          add_row(nodes, first ? below : below_before, first ? first - width : last);
        }
      }
    });
  }
  std::vector<double> result(model.n_nodes());
  for (std::size_t n = 0; n < result.size(); ++n) result[n] = at_slot[arrays.node_slot[n]];
  return result;
}

TimeStepBound time_step_bound(const VoxelModel& model, const SolverArrays& arrays,
                              const std::vector<double>& stiffness,
                              const std::vector<double>& at_node) {
  TimeStepBound bound;
  double highest = -1;
  for (std::size_t n = 0; n < model.n_nodes(); ++n) {
    if (model.fixed[3 * n] && model.fixed[3 * n + 1] && model.fixed[3 * n + 2]) continue;
    const double square = at_node[n] / arrays.node_mass[n];
    if (square > highest) {
      highest = square;
      bound = {2 / std::sqrt(square), n, 0};
    }
  }
  if (highest < 0) {
    bound.dt = HUGE_VAL;  // every node is fixed
    return bound;
  }
  double stiffest = -1;
  for (std::size_t e = 0; e < stiffness.size(); ++e) {
    if (stiffness[e] <= stiffest) continue;
    for (int corner = 0; corner < 8; ++corner)
      if (arrays.corner_slot(e, corner) == arrays.node_slot[bound.node]) {
        stiffest = stiffness[e];
        bound.element = e;
      }
  }
  return bound;
}

}  // namespace tledface
