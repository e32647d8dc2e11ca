// A bound of the explicit time step for each node.
#pragma once
#include <cstddef>
#include <vector>

#include "precompute/solver_arrays.hpp"

namespace tledface {

struct TimeStepBound {
  double dt = 0;             // s
  std::size_t node = 0;      // whose bound it is
  std::size_t element = 0;   // the stiffest of that node's elements
};

// 2 / max over nodes of omega, omega^2 = sum over its elements of omega_e^2 m_e/8, over m: from
// u K u <= sum_e omega_e^2 u M_e u, so it holds for the assembled operator, and a node with one
// element is bounded by that element alone. omega_e^2 = 4/rho (growth (lambda sum 1/h^2 +
// 2 mu/h_min^2) + k_f sum d^2/h^2): the largest eigenvalue of a one-point box, k_f the steepest slope of the
// fibres' nominal stress. `growth` (n_elements, or empty at rest) is that of the volumetric tangent
// under the deformation (kernels_cl/state.cl); an element with growth <= 0 is inverted: dt is 0.
TimeStepBound time_step_bound(const VoxelModel& model, const SolverArrays& arrays,
                              const std::vector<double>& growth = {});

}  // namespace tledface
