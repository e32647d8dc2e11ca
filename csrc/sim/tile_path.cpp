#include "sim/tile_path.hpp"

#include <algorithm>
#include <string>

#include "core/error.hpp"
#include "precompute/layout.hpp"
#include "precompute/tiles.hpp"

namespace tledface {
namespace {

// Where the kernel takes what changes.
constexpr unsigned kBlocks = 4, kNodeSets = 6, kHanded = 16, kStepIndex = 19, kIntegrates = 21,
                   kSliding = 21;
// Work-items a compute unit, in tiles: as many as run at a time. More of them, and lower, level the
// end out but compute more twice: on an H200 a shell takes 41 us with 1024, 37 with 512.
constexpr std::size_t kItemsPerUnit = 512;

class TilePath final : public ForcePath {
 public:
  TilePath(Device& device, const Binder& binder, const SolverArrays& arrays, const SolverBuffers& b,
           const ForcePathOptions& options)
      : binder_(binder),
        buffers_(b),
        width_(options.tile.width),
        step_reals_(options.step_reals),
        n_blocks_(arrays.n_blocks),
        form_(step_form(arrays, options)),
        u_{b.u[0], b.u[1]},
        group_(std::size_t(options.tile.width) * options.tile.rows) {
    const DeviceInfo& info = device.info();
    TileShape shape = options.tile;
    shape.depth = tile_depth(arrays, shape, kItemsPerUnit * std::max(1u, info.compute_units));
    const std::size_t largest = binder.make("step_tile_" + form_, {}, {})->largest_group(),
                      nodes = std::size_t(shape.width + 1) * (shape.rows + 1);
    local_ = 2 * (group_ * TLED_TILE_HANDED + 3 * nodes) * real_size(options.precision);
    if (group_ > largest || local_ > info.local_bytes)
      throw InputError("tile: " + std::to_string(shape.width) + " x " + std::to_string(shape.rows) +
                       " needs work-groups of " + std::to_string(group_) + " with " +
                       std::to_string(local_) + " bytes of local memory; device '" + info.id +
                       "' has at most " + std::to_string(largest) + " with " +
                       std::to_string(info.local_bytes) +
                       " for this model; use a smaller tile or kernels='gather'");
    const Tiles tiles = make_tiles(arrays, shape);
    n_items_ = tiles.size() * group_;
    tiles_ = binder.upload(tiles.tiles, bytes_);
    places_ = binder.upload(tiles.places, bytes_);
    for (int parity = 0; parity < 2; ++parity) {
      step_[parity] = make_kernel("step_tile_", parity);
      step_[parity]->set_arg(kIntegrates, std::int32_t(1));
    }
  }

  void bind_masses(const Buffer& blocks, const Buffer& node_sets) override {
    for (const auto* kernels : {&step_, &slide_})
      for (const auto& kernel : *kernels) {
        if (!kernel) continue;
        kernel->set_arg(kBlocks, blocks);
        kernel->set_arg(kNodeSets, node_sets);
      }
  }
  void enqueue_step(int now, std::int32_t index, int) override {
    step_[now]->set_arg(kStepIndex, index);
    step_[now]->enqueue(n_items_, group_);
  }
  bool fuse_sliding(const SlidingRowBuffers& sliding) override {
    if (!sliding.queue) return false;
    if (group_ > binder_.make("slide_tile_" + form_, {}, {})->largest_group()) return false;
    std::vector<std::int32_t> row_of_block(std::size_t(n_blocks_) + 1, -1);
    for (std::size_t row = 0; row < sliding.blocks->size(); ++row)
      row_of_block[(*sliding.blocks)[row]] = static_cast<std::int32_t>(row);
    row_of_block_ = binder_.upload(row_of_block, bytes_);
    for (int parity = 0; parity < 2; ++parity) {
      slide_[parity] = make_kernel("slide_tile_", parity);
      unsigned index = kSliding;
      for (const Buffer* buffer : {sliding.rows, sliding.regions, sliding.ints,
                                   static_cast<const Buffer*>(row_of_block_.get()), sliding.queue})
        slide_[parity]->set_arg(index++, *buffer);
      // Counted for the buffer that the step goes to.
      slide_[parity]->set_arg(index, std::int32_t(1 - parity));
    }
    return true;
  }
  void enqueue_sliding_step(int now, std::int32_t index) override {
    slide_[now]->set_arg(kStepIndex, index);
    slide_[now]->enqueue(n_items_, group_);
  }
  void enqueue_forces(int now, Buffer& force) override {
    Kernel& kernel = *step_[now];
    kernel.set_arg(1, force);
    kernel.set_arg(kStepIndex, std::int32_t(0));
    kernel.set_arg(kIntegrates, std::int32_t(0));
    kernel.enqueue(n_items_, group_);
    kernel.set_arg(1, *u_[1 - now]);
    kernel.set_arg(kIntegrates, std::int32_t(1));
  }

 private:
  std::unique_ptr<Kernel> make_kernel(const std::string& name, int parity) const {
    const SolverBuffers& b = buffers_;
    auto kernel = binder_.make(
        name + form_,
        {b.u[parity], b.u[1 - parity], tiles_.get(), places_.get(), b.blocks, b.materials,
         b.node_sets, b.law_entries, b.law_sets, b.history[parity], b.history[1 - parity],
         b.muscle_entries, b.muscle_sets, b.muscle_constants, b.shape, b.step_table},
        {});
    kernel->set_local(kHanded, local_);
    unsigned index = kHanded + 1;
    for (const std::int32_t value : {n_blocks_, width_, std::int32_t(0), step_reals_})
      kernel->set_arg(index++, value);
    return kernel;
  }

  const Binder binder_;
  const SolverBuffers buffers_;
  const std::int32_t width_, step_reals_, n_blocks_;
  const std::string form_;
  const Buffer* u_[2];
  std::size_t group_, n_items_ = 0, local_ = 0;
  std::unique_ptr<Buffer> tiles_, places_, row_of_block_;
  std::unique_ptr<Kernel> step_[2], slide_[2];
};

}  // namespace

std::unique_ptr<ForcePath> make_tile_path(Device& device, const Binder& binder,
                                          const SolverArrays& arrays, const SolverBuffers& buffers,
                                          const ForcePathOptions& options) {
  return std::make_unique<TilePath>(device, binder, arrays, buffers, options);
}

}  // namespace tledface
