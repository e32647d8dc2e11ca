// Nodes that slide on surfaces, on a device: the arrays of kernels_cl/sliding_layout.cl and the
// kernels that come last in each step.
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "backend/device.hpp"
#include "broad_phase/uniform_grid.hpp"
#include "precompute/solver_arrays.hpp"
#include "sim/force_path.hpp"

namespace tledface {

// Surfaces are in the frame of VoxelModel::position.
struct SlidingNodes {
  std::vector<std::int64_t> nodes;     // each once
  std::vector<double> distance;        // m, to be kept; negative behind the surface
  std::vector<std::int32_t> surface;   // of each node
  std::vector<TriangleMesh> surfaces;  // welded and oriented
  // Coefficient, and whether it may leave its surface, of each node; empty: none.
  std::vector<double> friction;
  std::vector<std::uint8_t> release;
  // Surfaces that move, in the order of their poses; all others stand still.
  std::vector<std::int32_t> moving;
  bool empty() const { return nodes.empty(); }
};

class Sliding {
 public:
  // tiles: whether tiles may put the nodes back. pose_column: of the step table, where the poses of
  // moving surfaces begin.
  Sliding(const SlidingNodes& given, const VoxelModel& model, const SolverArrays& arrays,
          Device& device, Program& program, Precision precision, bool vector_rows, bool tiles,
          std::int32_t pose_column);

  // Values a step that poses take: of each moving surface one at its begin, one at its end, 3 x 4
  // row by row, x = rotation . X + translation in the frame of VoxelModel::position.
  static constexpr std::size_t kPoseValues = 24;
  // Turns them into the kernel's axes and origin.
  void fill_poses(const double* values, double* columns) const;

  std::size_t bytes() const { return bytes_; }
  // Puts the nodes of a displacement back to their distances.
  void bind(const Buffer* const (&u)[2], const Buffer& blocks, const Buffer& step_table,
            std::int32_t step_reals);
  // Whether `blocks` has nodes above level 0 (subcycling).
  void set_has_levels(bool has_levels);
  // What a kernel that moves nodes needs to put these back itself; none where rows are not those of
  // blocks, where surfaces move, rub or let go.
  std::optional<SlidingRowBuffers> row_buffers() const;
  // keep_normals: for normals().
  void enqueue(int next, std::int32_t step_index, bool keep_normals);
  // What is left to do after a step of kernels that put the nodes back themselves.
  void enqueue_rest(int next, bool keep_normals);
  // Regions and candidates, as they lie on this device; see RawState.
  std::vector<std::uint8_t> state() const;
  // Refuses what is no state of these nodes; set_state takes what this let pass.
  void check_state(const std::vector<std::uint8_t>& state) const;
  void set_state(const std::vector<std::uint8_t>& state);
  // Every node seeks its surface at the next step.
  void forget();
  // Unit normals of the surfaces at the nodes when normals were last kept, 3 a node in the order
  // given, zero in held components: where their reactions point.
  std::vector<double> normals() const;
  // What friction took from each node since this was made, J for each kg of its mass.
  std::vector<double> friction_losses() const;

 private:
  // Rows of nodes whose surfaces stand still, or move as one.
  struct Group {
    std::size_t first_row, n_items;
    std::int32_t pose_column;
    std::unique_ptr<Kernel> kernel[2];
  };
  std::unique_ptr<Buffer> reals(const std::vector<double>& values);
  std::unique_ptr<Buffer> integers(const std::vector<std::int32_t>& values);
  std::vector<double> read_reals(const Buffer& buffer) const;
  std::array<Buffer*, 7> known() const;          // arrays of what state() holds
  std::vector<const Buffer*> arguments() const;  // TLED_SLIDING_ARGUMENTS
  std::uint8_t layout() const;
  // Of rows of blocks all; else those behind the last node share a slot of nothing.
  std::size_t n_places() const { return of_blocks_ ? n_rows_ * lanes_ : n_nodes_; }
  void empty_queue();
  std::vector<std::int32_t> read_integers(const Buffer& buffer) const;

  Device& device_;
  Precision precision_;
  std::size_t bytes_ = 0, n_nodes_, n_rows_ = 0, n_moving_;
  int lanes_;
  bool has_laws_, vector_rows_, queues_, of_blocks_;
  std::array<int, 3> order_;
  Vec3 centre_;
  std::vector<std::size_t> place_;  // of each node among the rows' lanes
  std::vector<Group> groups_;
  std::vector<std::int32_t> block_of_row_;  // where rows are those of blocks; -1: they are not
  std::unique_ptr<Kernel> keep_ways_[2];
  // Where nodes wait in a queue: slide_still and slide_queued of each direction.
  std::unique_ptr<Kernel> still_[2], queued_[2];
  std::unique_ptr<Buffer> queue_;
  std::size_t n_groups_ = 0;
  std::unique_ptr<Buffer> rows_, regions_, records_, heads_, ints_, laws_, candidates_,
      candidate_reals_, triangles_, grids_, grid_reals_, cell_begin_, cell_triangles_, zones_,
      triangle_zones_;
};

// Squared distance and nearest triangle of points (3 each) as the device's grid search finds them.
std::vector<NearestTriangle> nearest_in_grid(Device& device, Precision precision,
                                             const TriangleMesh& surface,
                                             const std::vector<Vec3>& points);

}  // namespace tledface
