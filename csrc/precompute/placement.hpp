// First stage of make_solver_arrays: which block and lane each node and element gets. Fills
// n_blocks, blocks (links, no rows yet), node_slot, element_slot and shape of `arrays`, whose lanes
// are known.
#pragma once
#include "precompute/solver_arrays.hpp"

namespace tledface {

// Neighbours of the grid share blocks; fills order and block_at too.
void place_voxels(const VoxelModel& model, const PrecomputeOptions& options, SolverArrays& arrays);

// Nodes and elements of a conforming mesh, each along a space-filling curve, so that what is
// gathered lies near; the element in a lane has nothing to do with the node there. Fills
// corner_slots and the hexahedra arrays too.
void place_hexahedra(const VoxelModel& model, SolverArrays& arrays);

}  // namespace tledface
