// VoxelModel -> the arrays of kernels_cl/layout.cl, for one number of lanes. Built in float64;
// the simulator narrows to the precision it runs in.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "precompute/voxel_model.hpp"

namespace tledface {

enum class HourglassForm { kPhysical, kKappa };

struct PrecomputeOptions {
  int lanes = 16;
  int width = 4;  // of them along x (TLED_WIDTH_OF of layout.cl), the rest along y
  HourglassForm hourglass = HourglassForm::kPhysical;
  double kappa = 0.075;
  // Solver axes; left at -1 they are chosen. History of laws is kept in these axes.
  std::array<int, 3> axis_order{-1, -1, -1};
};

struct SolverArrays {
  int lanes = 0, width = 0;
  // Solver axis a is axis order[a] of the model: the solver may run along another axis than x.
  std::array<int, 3> order{0, 1, 2};
  std::int32_t n_blocks = 0;         // without the empty one behind the last
  std::vector<std::int32_t> blocks;  // (n_blocks + 1) x TLED_BLOCK_INTS
  std::vector<double> materials, node_sets, law_sets, muscle_sets, muscle_constants, shape;
  std::vector<std::int32_t> law_entries, muscle_entries;
  std::int64_t n_history_rows = 0;  // of lanes
  // Of each of the model's laws with history, per element: where its first history row has the
  // element's lane (the next rows follow `lanes` apart).
  std::vector<std::vector<std::int64_t>> history_slot;
  std::vector<std::int64_t> node_slot;     // block * lanes + lane of each node
  std::vector<std::int64_t> element_slot;  // the same of each element
  std::vector<double> node_mass;           // kg
  std::size_t n_element_blocks = 0;

  // Of a conforming mesh only.
  std::vector<std::int64_t> corner_slots;  // 8 per element
  std::vector<std::int32_t> hex_nodes;     // (n_blocks, 8, lanes): where u of the corner begins
  std::vector<double> hex_rows;            // (n_blocks, TLED_HEX_ROWS, lanes)
  // node_forces[node_begin[slot]] ... [node_begin[slot + 1]]: where the node's corner forces are.
  std::vector<std::int32_t> node_begin, node_forces;

  // Place of every block: in x, in y, and z; for the rows that kernels walk (row_table.hpp).
  std::vector<std::array<std::int32_t, 3>> block_at;
  std::int32_t n_edges = 0;  // places of `edge` (layout.cl)

  // Slot of a corner of an element; bits of `corner`: 1 x, 2 y, 4 z (solver axes).
  std::int64_t corner_slot(std::size_t element, int corner) const;
  double fill() const;  // active share of the lanes that are computed
  // The same blocks as these options give, if order is the same.
  bool has_blocks(int of_lanes, int of_width) const {
    return lanes == of_lanes && width == of_width;
  }
};

SolverArrays make_solver_arrays(const VoxelModel& model, const PrecomputeOptions& options);

// Rows of history (n_history_rows x lanes) of one layout in another of the same model and axes.
std::vector<double> history_in_layout(const VoxelModel& model, const SolverArrays& from,
                                      const std::vector<double>& rows, const SolverArrays& to);

// Nodal vectors between the model's order and frame (3 per node) and the kernels' slots
// ((n_blocks + 1) x 3 x lanes; slots without node are 0).
std::vector<double> slots_to_nodes(const SolverArrays& arrays, const std::vector<double>& slots);
std::vector<double> nodes_to_slots(const SolverArrays& arrays, const std::vector<double>& nodes);

}  // namespace tledface
