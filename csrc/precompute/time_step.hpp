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

// Of each element rho omega_e^2 / 4 = growth (lambda sum 1/h^2 + 2 mu/h_min^2) + k_f sum d^2/h^2:
// the largest eigenvalue of a one-point box, k_f the steepest slope of its fibres' nominal stress
// over stretch at any activation and stretch. Pa/m2. growth: of the volumetric tangent
// (kernels_cl/step_bounds.cl), of each element, taken where above 1; empty: 1. What a look takes of
// the fibres instead is in that file too.
std::vector<double> element_stiffness(const VoxelModel& model,
                                      const std::vector<double>& growth = {});

// The same at rest without fibres.
std::vector<double> tissue_stiffness(const VoxelModel& model);

// Of each node, the sum of its elements' stiffness V/2, N/m: omega^2 times its mass.
std::vector<double> node_stiffness(const VoxelModel& model, const SolverArrays& arrays,
                                   const std::vector<double>& stiffness);

// 2 / max over nodes of omega, omega^2 = sum over its elements of omega_e^2 m_e/8, over m: from
// u K u <= sum_e omega_e^2 u M_e u, so it holds for the assembled operator, and a node with one
// element is bounded by that element alone.
// at_node: node_stiffness of the same.
TimeStepBound time_step_bound(const VoxelModel& model, const SolverArrays& arrays,
                              const std::vector<double>& stiffness,
                              const std::vector<double>& at_node);

}  // namespace tledface
