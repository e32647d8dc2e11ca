// How many vector instructions a step of a voxel model costs: the kernels' own text, run once with
// rows that count (backend/native/counted.hpp).
#pragma once
#include <array>

#include "backend/native/operation_counts.hpp"
#include "precompute/solver_arrays.hpp"

namespace tledface {

// Of one step of the row kernels, per element, with every lane filled and nothing computed twice;
// loads, stores and what is done for single nodes (sliding, loads) are not in it. axis_order: that
// of the simulator whose step it is.
native::OperationCounts operations_per_element(VoxelModel model, HourglassForm hourglass,
                                               const std::array<int, 3>& axis_order);

}  // namespace tledface
