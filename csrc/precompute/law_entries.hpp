// Which constitutive laws a block computes, with which rows: the law tables of
// kernels_cl/layout.cl.
#pragma once
#include "precompute/solver_arrays.hpp"

namespace tledface {

// Fills law_entries, law_sets, history_slot and the law links of `arrays`, whose blocks and element
// slots are there. Throws InputError for a law that is not compiled in or elements that do not
// exist.
void add_laws(const VoxelModel& model, SolverArrays& arrays);

}  // namespace tledface
