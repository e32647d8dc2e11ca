#include "precompute/row_table.hpp"

#include <algorithm>
#include <limits>

#include "precompute/layout.hpp"

namespace tledface {
namespace {

// A block of nodes without elements costs this much of one with them.
constexpr double kEmptyBlock = 0.25;

}  // namespace

RowTable make_row_table(const SolverArrays& arrays, const std::vector<std::uint8_t>& levels,
                        int highest) {
  const auto is_due = [&](std::int32_t b) { return levels.empty() || int(levels[b]) <= highest; };
  const auto link = [&](std::int32_t b, int which) {
    return arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS + which];
  };
  RowTable table;
  std::int32_t lowest = std::numeric_limits<std::int32_t>::max(), last = 0, n_chunks = 0;
  for (std::int32_t b = 0; b < arrays.n_blocks; ++b) {
    lowest = std::min(lowest, arrays.block_at[b][1]);
    last = std::max(last, arrays.block_at[b][1]);
    n_chunks = std::max(n_chunks, arrays.block_at[b][0] + 1);
    table.n_planes = std::max(table.n_planes, link(b, BLOCK_PLANE) + 1);
  }
  table.n_y = last - lowest + 1;
  const std::size_t n_places = std::size_t(n_chunks) * table.n_y;
  table.work.assign(n_places, 0);
  table.row_begin.reserve(n_places + 1);
  const auto n_runs = [&] { return static_cast<std::int32_t>(table.rows.size() / TLED_RUN); };
  // Blocks stand chunk by chunk, row by row, as the table does.
  const auto place_of = [&](std::int32_t b) {
    return std::size_t(arrays.block_at[b][0]) * table.n_y + (arrays.block_at[b][1] - lowest);
  };
  std::int32_t b = 0;
  for (std::size_t place = 0; place < n_places; ++place) {
    table.row_begin.push_back(n_runs());
    // Runs of blocks that are due; what is below a run gives it nothing.
    bool in_run = false;
    for (; b < arrays.n_blocks && place_of(b) == place; ++b) {
      if (!is_due(b)) {
        in_run = false;
        continue;
      }
      if (!in_run) table.rows.insert(table.rows.end(), {b, 0, 0, 0});
      in_run = true;
      ++table.rows[table.rows.size() - TLED_RUN + RUN_BLOCKS];
      table.work[place] += link(b, BLOCK_MATERIAL) >= 0 ? 1.0 : kEmptyBlock;
    }
  }
  table.row_begin.push_back(n_runs());
  return table;
}

RowDealer::RowDealer(const std::vector<double>& work, std::int32_t n_y)
    : sums_(work.size() + 1, 0.0), n_y_(n_y) {
  for (std::size_t i = 0; i < work.size(); ++i) sums_[i + 1] = sums_[i] + work[i];
}

double RowDealer::work(std::int32_t begin, std::int32_t end) const {
  return sums_[end] - before(begin);
}

// How far a band from `begin` on can go; as many cells as a chunk has at least.
std::int32_t RowDealer::end_within(std::int32_t begin, double most) const {
  const double until = before(begin) + most;
  const auto least =
      std::min<std::ptrdiff_t>(begin + n_y_ + 1, static_cast<std::ptrdiff_t>(sums_.size()));
  const auto behind = std::upper_bound(sums_.begin() + least, sums_.end(), until);
  return static_cast<std::int32_t>(behind - sums_.begin()) - 1;
}

std::vector<std::int32_t> RowDealer::deal(const std::vector<double>& speeds) const {
  const std::int32_t n = n_cells(), n_chunks = n / n_y_;
  const auto n_bands = std::min<std::int32_t>(static_cast<std::int32_t>(speeds.size()), n_chunks);
  const auto bands_within = [&](double seconds, std::vector<std::int32_t>* bands) {
    std::int32_t cell = 0;
    for (std::int32_t band = 0; band < n_bands; ++band) {
      const std::int32_t begin = cell;
      // Chunks are left for the others.
      cell = std::min(end_within(begin, seconds * speeds[band]), n - (n_bands - band - 1) * n_y_);
      if (bands) bands->insert(bands->end(), {begin, band + 1 < n_bands ? cell : n});
    }
    return cell == n;
  };
  double low = 0, high = 0;
  for (const double speed : speeds) high = std::max(high, sums_.back() / speed);
  // To a thousandth of what all would take.
  for (int halving = 0; halving < 30 && high - low > 1e-3 * low; ++halving) {
    const double middle = 0.5 * (low + high);
    (bands_within(middle, nullptr) ? high : low) = middle;
  }
  std::vector<std::int32_t> bands;
  bands_within(high, &bands);
  return bands;
}

}  // namespace tledface
