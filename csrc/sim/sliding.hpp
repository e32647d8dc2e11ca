// Nodes that slide on surfaces, on a device: the arrays of kernels_cl/sliding_layout.cl and the kernel
// that comes last in each step.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "backend/device.hpp"
#include "broad_phase/uniform_grid.hpp"
#include "precompute/solver_arrays.hpp"

namespace tledface {

// Surfaces are in the frame of VoxelModel::position.
struct SlidingNodes {
  std::vector<std::int64_t> nodes;     // each once
  std::vector<double> distance;        // m, to be kept; negative behind the surface
  std::vector<std::int32_t> surface;   // of each node
  std::vector<TriangleMesh> surfaces;  // welded and oriented
  bool empty() const { return nodes.empty(); }
};

class Sliding {
 public:
  Sliding(const SlidingNodes& given, const VoxelModel& model, const SolverArrays& arrays,
          Device& device, Program& program, Precision precision, bool vector_rows);

  std::size_t bytes() const { return bytes_; }
  // Puts the nodes of a displacement back to their distances.
  void bind(const Buffer* const (&u)[2]);
  void enqueue(int next);
  // Unit normals of the surfaces at the nodes when they were last moved, 3 a node in the order given,
  // zero in held components: where their reactions point.
  std::vector<double> normals() const;

 private:
  std::unique_ptr<Buffer> reals(const std::vector<double>& values);
  std::unique_ptr<Buffer> integers(const std::vector<std::int32_t>& values);

  Device& device_;
  Precision precision_;
  std::size_t bytes_ = 0, n_nodes_, n_rows_, n_items_;
  int lanes_;
  std::array<int, 3> order_;
  std::vector<std::size_t> place_;  // of each node among the rows' lanes
  std::unique_ptr<Buffer> rows_, ints_, candidates_, candidate_reals_, triangles_, grids_,
      grid_reals_, cell_begin_, cell_triangles_;
  std::unique_ptr<Kernel> kernel_[2];
};

// Squared distance and nearest triangle of points (3 each) as the device's grid search finds them.
std::vector<NearestTriangle> nearest_in_grid(Device& device, Precision precision,
                                             const TriangleMesh& surface,
                                             const std::vector<Vec3>& points);

}  // namespace tledface
