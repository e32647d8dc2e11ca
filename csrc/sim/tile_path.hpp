// The way of kernels_cl/tile.cl: one kernel a step.
#pragma once
#include "sim/force_path.hpp"
#include "sim/kernel_binder.hpp"

namespace tledface {

// Throws InputError where the device's work-groups are too small for the tile.
std::unique_ptr<ForcePath> make_tile_path(Device& device, const Binder& binder,
                                          const SolverArrays& arrays, const SolverBuffers& buffers,
                                          const ForcePathOptions& options);

}  // namespace tledface
