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
// Stretches at which a fibre's slope within its reach is looked at.
constexpr int kReachSamples = 7;

// Slope of stretch * f_pas(stretch) where the exponential ends; the line is steeper only beyond
// stretches of 1.4.
double steepest_passive_slope(double lambda_pas) {
  const double e = std::exp(6.6 * (lambda_pas - 1));
  return std::max(0.05 * (e - 1) + lambda_pas * 0.33 * e, 4.36 * 1.4 - 2.47);
}

// Fibre stress over J of kernels_cl/muscle/tension_length.cl and its slope over stretch, Pa.
struct Tension {
  double value, slope;
};

Tension fibre_tension(const VoxelMuscle& muscle, double activation, double stretch) {
  if (muscle.calcium) {
    const double sigma = activation * muscle.sigma_act,
                 factor = std::max(1 + muscle.beta * (stretch - 1), 0.0),
                 square = stretch * stretch;
    return {sigma * factor / square,
            sigma * ((factor > 0 ? muscle.beta : 0) - 2 * factor / stretch) / square};
  }
  const double lo = muscle.lambda_opt, x = stretch / lo;
  const double active = -6.25 * x * x + 12.5 * x - 5.25;
  Tension t{0, 0};
  if (active > 0) {
    t.value = activation * muscle.sigma_act * active;
    t.slope = activation * muscle.sigma_act * 12.5 * (1 - x) / lo;
  }
  if (stretch > muscle.lambda_pas) {
    const double line = muscle.printed_passive
                            ? 2.18 * stretch - 2.47
                            : 0.05 * (std::exp(6.6 * (muscle.lambda_pas - 1)) - 1) +
                                  2.18 * (stretch - muscle.lambda_pas);
    t.value += muscle.sigma_pas * line;
    t.slope += muscle.sigma_pas * 2.18;
  } else if (stretch > 1) {
    const double e = std::exp(6.6 * (stretch - 1));
    t.value += muscle.sigma_pas * 0.05 * (e - 1);
    t.slope += muscle.sigma_pas * 0.33 * e;
  }
  return t;
}

struct Fibre {
  double stretch, J, inverse_norm;  // of F^-1
};

Fibre fibre_state(const double* F, const double* d) {
  double cof[3][3], square = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const int a = (i + 1) % 3, b = (i + 2) % 3, c = (j + 1) % 3, e = (j + 2) % 3;
      cof[i][j] = F[3 * a + c] * F[3 * b + e] - F[3 * a + e] * F[3 * b + c];
      square += cof[i][j] * cof[i][j];
    }
  Fibre fibre{0, F[0] * cof[0][0] + F[1] * cof[0][1] + F[2] * cof[0][2], 0};
  for (int i = 0; i < 3; ++i) {
    const double v = F[3 * i] * d[0] + F[3 * i + 1] * d[1] + F[3 * i + 2] * d[2];
    fibre.stretch += v * v;
  }
  fibre.stretch = std::sqrt(fibre.stretch);
  fibre.inverse_norm = std::sqrt(square) / std::abs(fibre.J);
  return fibre;
}

}  // namespace

std::vector<double> element_stiffness(const VoxelModel& model, const StiffnessState& state) {
  const double* h = model.voxel.data();
  const double inverse_square[3] = {1 / (h[0] * h[0]), 1 / (h[1] * h[1]), 1 / (h[2] * h[2])};
  const double of_box = inverse_square[0] + inverse_square[1] + inverse_square[2];
  const double largest = *std::max_element(inverse_square, inverse_square + 3);
  const std::size_t n_elements = model.n_elements();

  std::vector<double> stiffness(n_elements);
  parallel_for_chunks(n_elements, kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t e = begin; e < end; ++e) {
      const double bulk = model.bulk_modulus[e], mu = model.shear_modulus[e];
      const double lambda = bulk - 2 * mu / 3;
      const double factor = state.growth.empty() ? 1 : std::max(state.growth[e], 1.0);
      stiffness[e] =
          factor * (model.conforming() ? model.hexahedra[e].stiffening *
                                             linear_stiffness(model.hexahedra[e], lambda, mu)
                                       : lambda * of_box + 2 * mu * largest);
      if (!state.growth.empty() && !(state.growth[e] > 0)) stiffness[e] = HUGE_VAL;
    }
  });
  for (std::size_t m = 0; m < model.muscles.size(); ++m) {
    const VoxelMuscle& muscle = model.muscles[m];
    const double steepest = muscle.sigma_act * kActiveSlope +
                            muscle.sigma_pas * steepest_passive_slope(muscle.lambda_pas);
    // An element is once in a muscle.
    const auto add = [&](std::size_t i) {
      const double* d = &muscle.fibre[3 * i];
      double along = 0, sum = of_box;
      if (model.conforming()) {  // 2 d.G d and 2 tr G in place of sums over 1/h^2
        const auto G = model.hexahedra[muscle.elements[i]].gradient_square();
        along = 2 * (G[0] * d[0] * d[0] + G[1] * d[1] * d[1] + G[2] * d[2] * d[2]) +
                4 * (G[3] * d[0] * d[1] + G[4] * d[1] * d[2] + G[5] * d[0] * d[2]);
        sum = 2 * (G[0] + G[1] + G[2]);
      } else {
        for (int c = 0; c < 3; ++c) along += d[c] * d[c] * inverse_square[c];
      }
      double added = steepest * along;
      if (!state.activations.empty()) {
        const Fibre fibre = fibre_state(&state.deformation_gradient[9 * muscle.elements[i]], d);
        if (!(fibre.J > 0)) return;
        added = 0;
        for (int k = 0; k < kReachSamples; ++k) {
          const double share =
              state.reach_low + (state.reach_high - state.reach_low) * k / (kReachSamples - 1);
          const double stretch = share * fibre.stretch;
          const Tension t = fibre_tension(muscle, state.activations[m], stretch);
          // P = J T(stretch) F d (x) d: along the fibre, across it, and through J: the symmetric
          // part of F d (x) d times F^-T is at most (|F d| |F^-1| + 1)/2.
          const double straight = std::max(t.value + stretch * t.slope, t.value) * along;
          const double through_J =
              std::abs(t.value) * 0.5 * (stretch * fibre.inverse_norm + 1) * std::sqrt(along * sum);
          added = std::max(added, fibre.J * (std::max(straight, 0.0) + through_J));
        }
      }
      stiffness[muscle.elements[i]] += muscle.weight[i] * added;
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
    // Nodes gather, in one order: of the lanes of four rows, those at their own place and before.
    std::vector<double> of_element(n_slots, 0.0);
    parallel_for_chunks(stiffness.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      for (std::size_t e = begin; e < end; ++e) of_element[arrays.element_slot[e]] = share(e);
    });
    const auto link = [&](std::size_t block, int which) {
      return std::size_t(arrays.blocks[block * TLED_BLOCK_INTS + which]);
    };
    parallel_for_chunks(arrays.n_blocks, kChunk / lanes, [&](std::size_t begin, std::size_t end) {
      for (std::size_t b = begin; b < end; ++b) {
        const std::size_t before_y = link(b, BLOCK_PREV_Y);
        double* nodes = &at_slot[b * lanes];
        for (const std::size_t row :
             {b, before_y, link(b, BLOCK_PREV_Z), link(before_y, BLOCK_PREV_Z)}) {
          const double* elements = &of_element[row * lanes];
          nodes[0] += elements[0] + of_element[link(row, BLOCK_PREV_X) * lanes + lanes - 1];
          for (std::size_t l = 1; l < lanes; ++l) nodes[l] += elements[l] + elements[l - 1];
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
