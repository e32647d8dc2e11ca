// A bound of the explicit time step for each node.
#pragma once
#include <cstddef>
#include <vector>

#include "precompute/solver_arrays.hpp"

namespace tledface {

struct TimeStepBound {
  double dt = 0;            // s
  std::size_t node = 0;     // whose bound it is
  std::size_t element = 0;  // the stiffest of that node's elements
};

// What the stiffness of elements depends on. Empty: growth 1; each muscle's steepest slope at any
// activation and stretch.
struct StiffnessState {
  // Of the volumetric tangent (kernels_cl/state.cl), n_elements; <= 0: inverted.
  std::vector<double> growth;
  std::vector<double> deformation_gradient;  // 9 per element
  std::vector<double> activations;           // one a muscle
  // The steepest slope of a fibre within these shares of its stretch is taken.
  double reach_low = 1, reach_high = 1;
};

// Of each element rho omega_e^2 / 4 = growth (lambda sum 1/h^2 + 2 mu/h_min^2) + k_f sum d^2/h^2:
// the largest eigenvalue of a one-point box, k_f the stiffness of its fibres (nominal stress over
// stretch, or the stress itself across the fibre). Infinite where inverted. Pa/m2.
std::vector<double> element_stiffness(const VoxelModel& model, const StiffnessState& state = {});

// Of each node, the sum of its elements' stiffness V/2, N/m: omega^2 times its mass.
std::vector<double> node_stiffness(const VoxelModel& model, const SolverArrays& arrays,
                                   const std::vector<double>& stiffness);

// 2 / max over nodes of omega, omega^2 = sum over its elements of omega_e^2 m_e/8, over m: from
// u K u <= sum_e omega_e^2 u M_e u, so it holds for the assembled operator, and a node with one
// element is bounded by that element alone. An inverted element: dt is 0.
// at_node: node_stiffness of the same.
TimeStepBound time_step_bound(const VoxelModel& model, const SolverArrays& arrays,
                              const std::vector<double>& stiffness,
                              const std::vector<double>& at_node);

}  // namespace tledface
