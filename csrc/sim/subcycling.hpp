// Subcycling: each block of nodes and of elements takes steps of 2^level of the shortest step, as
// long as its own tissue allows.
//
// Elements give their nodes impulses: on level l one of 2^l d f every 2^l of the shortest steps d,
// in between nodes drift. That is an asynchronous variational integrator (Lew, Marsden, Ortiz &
// West 2003, Arch. Ration. Mech. Anal. 167) with steps in powers of two (r-RESPA: Tuckerman, Berne
// & Martyna 1992, J. Chem. Phys. 97): an impulse is the same on all of an element's nodes whenever
// it comes, so linear and angular momentum are kept to rounding, and the map is symplectic. An
// element is as fast as the fastest of its nodes' bounds, so what is slow borders on nodes that
// are slow by themselves: the resonances of such methods are then weak (docs: subcycling).
#pragma once
#include <cstdint>
#include <vector>

#include "precompute/solver_arrays.hpp"

namespace tledface {

struct BlockLevels {
  int n_levels = 1;                           // levels are below
  std::vector<std::uint8_t> nodes, elements;  // of each block
  std::int64_t substeps() const { return std::int64_t(1) << (n_levels - 1); }
};

BlockLevels same_level(const SolverArrays& arrays);

// node_squares: omega^2 of each node's bound (precompute/time_step.hpp), 1/s^2, 0 where it is held.
// Elements with laws beyond the base, whose stiffness the bound does not know, are on level 0. A
// block keeps the level it has in `now` where that is allowed without margin.
BlockLevels choose_levels(const VoxelModel& model, const SolverArrays& arrays,
                          const std::vector<double>& node_squares, double shortest_step,
                          int n_levels, const BlockLevels& now);

// Time of a step of the longest over that of the same without subcycling, estimated.
double relative_cost(const SolverArrays& arrays, const BlockLevels& levels);

// Links of blocks (kernels_cl/layout.cl) with their levels.
std::vector<std::int32_t> links_with_levels(const SolverArrays& arrays, const BlockLevels& levels);

}  // namespace tledface
