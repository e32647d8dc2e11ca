// How one step is computed: which kernels give element forces and move the nodes. Four ways, see
// kernels_cl/rows.cl (CPUs), tile.cl and gather.cl (GPUs), hexahedra.cl (conforming meshes
// anywhere). What acts on single nodes comes after them (nodal_conditions.hpp).
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "backend/device.hpp"
#include "precompute/solver_arrays.hpp"
#include "precompute/tiles.hpp"
#include "sim/subcycling.hpp"

namespace tledface {

enum class KernelPath { kAuto, kRows, kGather, kTile };

// Device arrays that all ways read; state and histories of laws are read and written in turns.
struct SolverBuffers {
  const Buffer *u[2], *history[2];
  const Buffer *blocks, *materials, *node_sets, *law_entries, *law_sets, *muscle_entries,
      *muscle_sets, *muscle_constants, *shape, *step_table;
};

// What a conforming mesh has besides; null for voxels.
struct HexahedraBuffers {
  const Buffer *nodes = nullptr, *rows = nullptr, *begin = nullptr, *places = nullptr;
};

struct ForcePathOptions {
  Precision precision = Precision::kSingle;
  HourglassForm hourglass = HourglassForm::kPhysical;
  bool rows = true;    // of voxels: rows rather than gather or tile
  bool tiles = false;  // of voxels without rows: tile rather than gather
  TileShape tile;
  std::size_t n_bands = 0;  // of row kernels; 0: by the device's compute units
  std::int32_t step_reals = 0;
};

// Rows of sliding nodes that kernels can put back themselves (kernels_cl/sliding_rows.cl, tile.cl).
struct SlidingRowBuffers {
  std::vector<const Buffer*> arguments;     // TLED_SLIDING_ARGUMENTS
  const std::vector<std::int32_t>* blocks;  // of each row, ascending
  const Buffer *rows, *regions, *ints;      // among the arguments
  const Buffer* queue;  // of nodes that wait for a kernel of their own; null: looked at at once
};

class ForcePath {
 public:
  virtual ~ForcePath() = default;
  // Which links and inverse masses the nodes are moved with.
  virtual void bind_masses(const Buffer& blocks, const Buffer& node_sets) = 0;
  // A step from u[now] into u[1 - now], with row `index` of the step table, of the blocks up to
  // level `highest`; -1: of all.
  virtual void enqueue_step(int now, std::int32_t index, int highest) = 0;
  // The same of all, after which sliding nodes are where they belong; only where fuse_sliding said
  // so.
  virtual bool fuse_sliding(const SlidingRowBuffers& sliding) {
    static_cast<void>(sliding);
    return false;
  }
  virtual void enqueue_sliding_step(int now, std::int32_t index) {
    static_cast<void>(now), static_cast<void>(index);
  }
  // After all that changes u of the step: blocks above level 0 are left as the next step needs
  // them.
  virtual void enqueue_swap(int highest) { static_cast<void>(highest); }
  // Paths that cannot subcycle have one level.
  virtual bool subcycles() const { return false; }
  virtual void set_levels(const BlockLevels& levels) { static_cast<void>(levels); }
  // Forces of the elements on the nodes under u[now], row 0 of the table; histories stay.
  virtual void enqueue_forces(int now, Buffer& force) = 0;
  virtual HexahedraBuffers hexahedra() const { return {}; }
  std::size_t bytes() const { return bytes_; }  // of its own arrays

 protected:
  std::size_t bytes_ = 0;
};

std::unique_ptr<ForcePath> make_force_path(Device& device, Program& program,
                                           const SolverArrays& arrays, const SolverBuffers& buffers,
                                           const ForcePathOptions& options);

}  // namespace tledface
