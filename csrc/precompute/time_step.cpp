#include "precompute/time_step.hpp"

#include <algorithm>
#include <cmath>

namespace tledface {
namespace {

// Largest slope of stretch * f_act(stretch) (at stretch 2/3 lambda_opt: 3.083), which the active
// stress reaches on its ascending limb.
constexpr double kActiveSlope = 37.0 / 12.0;

// Slope of stretch * f_pas(stretch) where the exponential ends; the line is steeper only beyond
// stretches of 1.4.
double passive_slope(double lambda_pas) {
  const double e = std::exp(6.6 * (lambda_pas - 1));
  return std::max(0.05 * (e - 1) + lambda_pas * 0.33 * e, 4.36 * 1.4 - 2.47);
}

}  // namespace

TimeStepBound time_step_bound(const VoxelModel& model, const SolverArrays& arrays,
                              const std::vector<double>& growth) {
  const double* h = model.voxel.data();
  const double volume = h[0] * h[1] * h[2];
  const double inverse_square[3] = {1 / (h[0] * h[0]), 1 / (h[1] * h[1]), 1 / (h[2] * h[2])};
  const double sum = inverse_square[0] + inverse_square[1] + inverse_square[2];
  const double largest = *std::max_element(inverse_square, inverse_square + 3);
  const std::size_t n_elements = model.n_elements();

  // Stiffness of an element: rho omega_e^2 / 4.
  std::vector<double> stiffness(n_elements);
  for (std::size_t e = 0; e < n_elements; ++e) {
    const double bulk = model.bulk_log[e] + model.bulk_quadratic[e], mu = model.mu[e];
    const double factor = growth.empty() ? 1 : std::max(growth[e], 1.0);
    stiffness[e] = factor * ((bulk - 2 * mu / 3) * sum + 2 * mu * largest);
    if (!growth.empty() && !(growth[e] > 0)) stiffness[e] = HUGE_VAL;
  }
  for (const VoxelMuscle& muscle : model.muscles) {
    const double slope =
        muscle.sigma_act * kActiveSlope + muscle.sigma_pas * passive_slope(muscle.lambda_pas);
    for (std::size_t i = 0; i < muscle.elements.size(); ++i) {
      double along = 0;
      for (int c = 0; c < 3; ++c)
        along += muscle.fibre[3 * i + c] * muscle.fibre[3 * i + c] * inverse_square[c];
      stiffness[muscle.elements[i]] += muscle.weight[i] * slope * along;
    }
  }

  // A node's omega^2 times its mass: sum of omega_e^2 rho V/8 = stiffness V/2, over its elements.
  std::vector<double> weighted(std::size_t(arrays.n_blocks + 1) * arrays.lanes, 0.0), stiffest(weighted);
  std::vector<std::size_t> stiffest_element(weighted.size(), 0);
  for (std::size_t e = 0; e < n_elements; ++e) {
    for (int corner = 0; corner < 8; ++corner) {
      const std::size_t at = arrays.corner_slot(e, corner);
      weighted[at] += stiffness[e] * volume / 2;
      if (stiffness[e] > stiffest[at]) {
        stiffest[at] = stiffness[e];
        stiffest_element[at] = e;
      }
    }
  }
  TimeStepBound bound;
  double highest = -1;
  for (std::size_t n = 0; n < model.n_nodes(); ++n) {
    if (model.fixed[3 * n] && model.fixed[3 * n + 1] && model.fixed[3 * n + 2]) continue;
    const std::size_t at = arrays.node_slot[n];
    const double square = weighted[at] / arrays.node_mass[n];
    if (square > highest) {
      highest = square;
      bound = {2 / std::sqrt(square), n, stiffest_element[at]};
    }
  }
  if (highest < 0) bound.dt = HUGE_VAL;  // every node is fixed
  return bound;
}

}  // namespace tledface
