#include "sim/force_path.hpp"

#include <algorithm>
#include <string>
#include <vector>

#include "precompute/layout.hpp"
#include "precompute/row_table.hpp"
#include "sim/band_balance.hpp"
#include "sim/kernel_binder.hpp"
#include "sim/tile_path.hpp"

namespace tledface {
namespace {

// Where the kernels take the index of the step in the table.
constexpr unsigned kRowsStepIndex = 23, kElementsStepIndex = 14, kNodesStepIndex = 7,
                   kHexStepIndex = 16, kHexNodesStepIndex = 9;
constexpr unsigned kElementsStore = 16, kHexStore = 18;  // 1: the history of laws is kept
// Where those that integrate take the links of blocks and the inverse masses.
constexpr unsigned kRowsBands = 2, kRowsBegin = 3, kRowsRows = 4, kRowsBlocks = 5,
                   kRowsNodeSets = 7, kRowsCount = 19, kRowsSliding = 25, kNodesBlocks = 3,
                   kNodesNodeSets = 4, kSwapList = 2, kSwapCount = 3;
// Work-items a group of the gather kernels: four blocks of 16 lanes.
constexpr std::size_t kGroup = 64;

class RowsPath final : public ForcePath {
 public:
  RowsPath(Device& device, const Binder& binder, const SolverArrays& arrays, const SolverBuffers& b,
           const ForcePathOptions& options)
      : binder_(binder), arrays_(arrays), buffers_(b), options_(options), u_{b.u[0], b.u[1]} {
    // Each further band computes a chunk twice; two for a thread level threads out by less than
    // that.
    n_bands_ = options.n_bands ? options.n_bands : device.info().compute_units;
    all_ = make_rows(make_row_table(arrays));
    const std::size_t real = real_size(options.precision);
    // Rows of levels are dealt to as many bands: they have the same chunks.
    const std::size_t n_dealt = all_.balance.n_bands();
    const std::size_t scratch = SCRATCH_REALS(std::size_t(all_.table.n_planes), arrays.lanes),
                      edges =
                          BAND_EDGE_REALS(std::size_t(arrays.n_edges), arrays.width, arrays.lanes);
    scratch_ = binder.allocate(n_dealt * scratch * real, bytes_);
    edge_ = binder.allocate(n_dealt * edges * real, bytes_);
    for (int parity = 0; parity < 2; ++parity) {
      step_[parity] = make_kernel("step_rows_" + step_form(arrays, options), parity);
      force_[parity] = make_kernel("force_rows_" + form_of(options), parity);
    }
  }

  void bind_masses(const Buffer& blocks, const Buffer& node_sets) override {
    for (const auto& kernel : step_) {
      kernel->set_arg(kRowsBlocks, blocks);
      kernel->set_arg(kRowsNodeSets, node_sets);
    }
  }
  void enqueue_step(int now, std::int32_t index, int highest) override {
    const bool has_levels = highest >= 0 && !due_.empty();
    const bool some = has_levels && highest + 1 < static_cast<int>(due_.size());
    DueRows& rows = some ? due_[highest] : all_;
    if (rows.balance.n_bands() == 0) return;
    Kernel& kernel = has_levels ? *step_levels_[now] : *step_[now];
    kernel.set_arg(kRowsBands, *rows.bands);
    kernel.set_arg(kRowsBegin, *rows.row_begin);
    kernel.set_arg(kRowsRows, *rows.rows);
    kernel.set_arg(kRowsCount, static_cast<std::int32_t>(rows.balance.n_bands()));
    kernel.set_arg(kRowsStepIndex, index);
    enqueue_bands(kernel, rows);
  }
  void enqueue_forces(int now, Buffer& force) override {
    force_[now]->set_arg(1, force);
    force_[now]->enqueue(all_.balance.n_bands(), 1);
    force_[now]->set_arg(1, *u_[1 - now]);
  }

  bool fuse_sliding(const SlidingRowBuffers& sliding) override {
    std::vector<std::int32_t> rows = all_.table.rows;
    const std::vector<std::int32_t>& blocks = *sliding.blocks;
    for (std::size_t row = 0; row < rows.size(); row += TLED_RUN) {
      const std::int32_t begin = rows[row + RUN_BLOCK], end = begin + rows[row + RUN_BLOCKS];
      const auto first = std::lower_bound(blocks.begin(), blocks.end(), begin);
      rows[row + RUN_SLIDING] = static_cast<std::int32_t>(first - blocks.begin());
      rows[row + RUN_SLIDING_COUNT] =
          static_cast<std::int32_t>(std::lower_bound(first, blocks.end(), end) - first);
    }
    sliding_rows_ = binder_.upload(rows, bytes_);
    for (int parity = 0; parity < 2; ++parity) {
      step_sliding_[parity] = make_kernel("step_sliding_" + step_form(arrays_, options_), parity);
      step_sliding_[parity]->set_arg(kRowsRows, *sliding_rows_);
      unsigned index = kRowsSliding;
      for (const Buffer* buffer : sliding.arguments)
        step_sliding_[parity]->set_arg(index++, *buffer);
    }
    return true;
  }
  void enqueue_sliding_step(int now, std::int32_t index) override {
    step_sliding_[now]->set_arg(kRowsStepIndex, index);
    enqueue_bands(*step_sliding_[now], all_);
  }

  bool subcycles() const override { return true; }
  void set_levels(const BlockLevels& levels) override {
    due_.clear();
    swap_ends_.assign(levels.n_levels, 0);
    if (levels.n_levels == 1) return;
    for (int parity = 0; parity < 2; ++parity)
      if (!step_levels_[parity])
        step_levels_[parity] = make_kernel("step_levels_" + step_form(arrays_, options_), parity);
    for (int level = 0; level < levels.n_levels; ++level)
      due_.push_back(level + 1 < levels.n_levels
                         ? make_rows(make_row_table(arrays_, levels.nodes, level))
                         : DueRows());
    std::vector<std::int32_t> list;
    for (int level = 1; level < levels.n_levels; ++level) {
      for (std::int32_t b = 0; b < arrays_.n_blocks; ++b)
        if (levels.nodes[b] == level) list.push_back(b);
      swap_ends_[level] = static_cast<std::int32_t>(list.size());
    }
    if (list.empty()) return;
    swap_list_ = binder_.upload(list, bytes_);
    if (!swap_) swap_ = binder_.make("swap_blocks", {u_[0], u_[1]}, {});
    swap_->set_arg(kSwapList, *swap_list_);
  }
  void enqueue_swap(int highest) override {
    const std::int32_t n = highest > 0 ? swap_ends_[highest] : 0;
    if (n == 0) return;
    swap_->set_arg(kSwapCount, n);
    swap_->enqueue(static_cast<std::size_t>(n), kGroup);
  }

 private:
  // Rows that a step walks.
  struct DueRows {
    RowTable table;
    BandBalance balance;
    std::unique_ptr<Buffer> bands, row_begin, rows;
  };

  DueRows make_rows(RowTable table) {
    DueRows due;
    if (!table.rows.empty()) {
      due.balance = BandBalance(table.work, table.n_y, n_bands_);
      due.bands = binder_.upload(due.balance.bands(), bytes_);
      due.row_begin = binder_.upload(table.row_begin, bytes_);
      due.rows = binder_.upload(table.rows, bytes_);
    }
    due.table = std::move(table);
    return due;
  }
  static void enqueue_bands(Kernel& kernel, DueRows& rows) {
    const bool is_timed = kernel.time_items(rows.balance.seconds());
    kernel.enqueue(rows.balance.n_bands(), 1);
    if (!is_timed || !rows.balance.enter()) return;
    const std::vector<std::int32_t>& bands = rows.balance.bands();
    rows.bands->write(bands.data(), bands.size() * sizeof(std::int32_t));
  }
  std::unique_ptr<Kernel> make_kernel(const std::string& name, int parity) const {
    const SolverBuffers& b = buffers_;
    return binder_.make(
        name,
        {b.u[parity], b.u[1 - parity], all_.bands.get(), all_.row_begin.get(), all_.rows.get(),
         b.blocks, b.materials, b.node_sets, b.law_entries, b.law_sets, b.history[parity],
         b.history[1 - parity], b.muscle_entries, b.muscle_sets, b.muscle_constants, b.shape,
         b.step_table, scratch_.get(), edge_.get()},
        {static_cast<std::int32_t>(all_.balance.n_bands()), all_.table.n_planes, arrays_.n_edges,
         all_.table.n_y, 0, options_.step_reals});
  }

  const Binder binder_;
  const SolverArrays& arrays_;
  const SolverBuffers buffers_;
  const ForcePathOptions options_;
  const Buffer* u_[2];
  std::size_t n_bands_ = 0;
  DueRows all_;
  std::vector<DueRows> due_;  // by the highest level that is due; of the highest of all: all_
  std::vector<std::int32_t> swap_ends_;  // by the highest level: how many of the list
  std::unique_ptr<Buffer> scratch_, edge_, swap_list_, sliding_rows_;
  std::unique_ptr<Kernel> step_[2], step_sliding_[2], step_levels_[2], force_[2], swap_;
};

class GatherPath final : public ForcePath {
 public:
  GatherPath(const Binder& binder, const SolverArrays& arrays, const SolverBuffers& b,
             const ForcePathOptions& options)
      : n_slots_(std::size_t(arrays.n_blocks) * arrays.lanes) {
    element_forces_ =
        binder.allocate((n_slots_ + arrays.lanes) * 24 * real_size(options.precision), bytes_);
    for (int parity = 0; parity < 2; ++parity) {
      step_[parity] =
          binder.make("element_forces_" + form_of(options),
                      {b.u[parity], element_forces_.get(), b.blocks, b.materials, b.law_entries,
                       b.law_sets, b.history[parity], b.history[1 - parity], b.muscle_entries,
                       b.muscle_sets, b.muscle_constants, b.shape, b.step_table},
                      {arrays.n_blocks, 0, options.step_reals, 1});
      integrate_[parity] = binder.make("integrate_nodes",
                                       {b.u[parity], b.u[1 - parity], element_forces_.get(),
                                        b.blocks, b.node_sets, b.step_table},
                                       {arrays.n_blocks, 0, options.step_reals});
    }
    gather_ =
        binder.make("gather_forces", {b.u[0], element_forces_.get(), b.blocks}, {arrays.n_blocks});
  }

  void bind_masses(const Buffer& blocks, const Buffer& node_sets) override {
    for (const auto& kernel : integrate_) {
      kernel->set_arg(kNodesBlocks, blocks);
      kernel->set_arg(kNodesNodeSets, node_sets);
    }
  }
  void enqueue_step(int now, std::int32_t index, int) override {
    step_[now]->set_arg(kElementsStepIndex, index);
    step_[now]->enqueue(n_slots_, kGroup);
    integrate_[now]->set_arg(kNodesStepIndex, index);
    integrate_[now]->enqueue(n_slots_, kGroup);
  }
  void enqueue_forces(int now, Buffer& force) override {
    step_[now]->set_arg(kElementsStepIndex, std::int32_t(0));
    step_[now]->set_arg(kElementsStore, std::int32_t(0));
    step_[now]->enqueue(n_slots_, kGroup);
    step_[now]->set_arg(kElementsStore, std::int32_t(1));
    gather_->set_arg(0, force);
    gather_->enqueue(n_slots_, kGroup);
  }

 private:
  std::size_t n_slots_;
  std::unique_ptr<Buffer> element_forces_;
  std::unique_ptr<Kernel> step_[2], integrate_[2], gather_;
};

class HexahedraPath final : public ForcePath {
 public:
  HexahedraPath(const Binder& binder, const SolverArrays& arrays, const SolverBuffers& b,
                const ForcePathOptions& options)
      // A work-item is a block of elements where rows are vectors, else an element.
      : n_items_(std::size_t(arrays.n_blocks) * (options.rows ? 1 : arrays.lanes)),
        n_slots_(std::size_t(arrays.n_blocks) * arrays.lanes) {
    const std::size_t real = real_size(options.precision);
    element_forces_ = binder.allocate(n_slots_ * 24 * real, bytes_);
    nodes_ = binder.upload(arrays.hex_nodes, bytes_);
    begin_ = binder.upload(arrays.node_begin, bytes_);
    places_ = binder.upload(arrays.node_forces, bytes_);
    rows_ = binder.allocate(arrays.hex_rows.size() * real, bytes_);
    if (options.precision == Precision::kDouble) {
      rows_->write(arrays.hex_rows.data(), arrays.hex_rows.size() * real);
    } else {
      const std::vector<float> narrow(arrays.hex_rows.begin(), arrays.hex_rows.end());
      rows_->write(narrow.data(), narrow.size() * real);
    }
    const auto n_slots = static_cast<std::int32_t>(n_slots_);
    for (int parity = 0; parity < 2; ++parity) {
      step_[parity] = binder.make(
          "hex_forces_" + form_of(options),
          {b.u[parity], element_forces_.get(), b.blocks, b.materials, b.law_entries, b.law_sets,
           b.history[parity], b.history[1 - parity], b.muscle_entries, b.muscle_sets,
           b.muscle_constants, b.shape, b.step_table, nodes_.get(), rows_.get()},
          {arrays.n_blocks, 0, options.step_reals, 1});
      integrate_[parity] =
          binder.make("hex_integrate_nodes",
                      {b.u[parity], b.u[1 - parity], element_forces_.get(), b.blocks, b.node_sets,
                       b.step_table, begin_.get(), places_.get()},
                      {n_slots, 0, options.step_reals});
    }
    gather_ = binder.make("hex_gather_forces",
                          {b.u[0], element_forces_.get(), begin_.get(), places_.get()}, {n_slots});
  }

  void bind_masses(const Buffer& blocks, const Buffer& node_sets) override {
    for (const auto& kernel : integrate_) {
      kernel->set_arg(kNodesBlocks, blocks);
      kernel->set_arg(kNodesNodeSets, node_sets);
    }
  }
  void enqueue_step(int now, std::int32_t index, int) override {
    step_[now]->set_arg(kHexStepIndex, index);
    step_[now]->enqueue(n_items_, kGroup);
    integrate_[now]->set_arg(kHexNodesStepIndex, index);
    integrate_[now]->enqueue(n_slots_, kGroup);
  }
  void enqueue_forces(int now, Buffer& force) override {
    step_[now]->set_arg(kHexStepIndex, std::int32_t(0));
    step_[now]->set_arg(kHexStore, std::int32_t(0));
    step_[now]->enqueue(n_items_, kGroup);
    step_[now]->set_arg(kHexStore, std::int32_t(1));
    gather_->set_arg(0, force);
    gather_->enqueue(n_slots_, kGroup);
  }

  HexahedraBuffers hexahedra() const override {
    return {nodes_.get(), rows_.get(), begin_.get(), places_.get()};
  }

 private:
  std::size_t n_items_, n_slots_;
  std::unique_ptr<Buffer> element_forces_, nodes_, rows_, begin_, places_;
  std::unique_ptr<Kernel> step_[2], integrate_[2], gather_;
};

}  // namespace

std::unique_ptr<ForcePath> make_force_path(Device& device, Program& program,
                                           const SolverArrays& arrays, const SolverBuffers& buffers,
                                           const ForcePathOptions& options) {
  const Binder binder(device, program);
  if (!arrays.hex_nodes.empty())
    return std::make_unique<HexahedraPath>(binder, arrays, buffers, options);
  if (options.rows) return std::make_unique<RowsPath>(device, binder, arrays, buffers, options);
  if (options.tiles) return make_tile_path(device, binder, arrays, buffers, options);
  return std::make_unique<GatherPath>(binder, arrays, buffers, options);
}

}  // namespace tledface
