// Deals node rows to bands, the work-items of the row kernels (kernels_cl/rows.cl).
#include <algorithm>
#include <limits>
#include <numeric>

#include "precompute/layout.hpp"
#include "precompute/solver_arrays.hpp"

namespace tledface {

RowBands SolverArrays::make_bands(std::size_t n_bands, const std::vector<std::uint8_t>& levels,
                                  int highest_level) const {
  const auto is_due = [&](std::int32_t b) {
    return levels.empty() || int(levels[b]) <= highest_level;
  };
  RowBands result;
  std::int32_t lowest = std::numeric_limits<std::int32_t>::max(), highest = 0, n_chunks = 0;
  for (std::int32_t b = 0; b < n_blocks; ++b) {
    lowest = std::min(lowest, block_at[b][1]);
    highest = std::max(highest, block_at[b][1]);
    n_chunks = std::max(n_chunks, block_at[b][0] + 1);
    result.n_planes =
        std::max(result.n_planes, blocks[std::size_t(b) * TLED_BLOCK_INTS + BLOCK_PLANE] + 1);
  }
  const std::int32_t n_y = highest - lowest + 1;
  // First block and count of each (chunk, y) row; work in each y.
  std::vector<std::int32_t> first(std::size_t(n_chunks) * n_y, 0), count(first.size(), 0);
  std::vector<double> work(n_y, 0);
  for (std::int32_t b = 0; b < n_blocks; ++b) {
    const std::int32_t y = block_at[b][1] - lowest;
    const std::size_t at = std::size_t(block_at[b][0]) * n_y + y;
    if (count[at]++ == 0) first[at] = b;
    if (!is_due(b)) continue;
    work[y] += blocks[std::size_t(b) * TLED_BLOCK_INTS + BLOCK_MATERIAL] >= 0 ? 1.0 : 0.25;
  }
  const double total = std::accumulate(work.begin(), work.end(), 0.0);
  n_bands = std::max<std::size_t>(1, std::min<std::size_t>(n_bands, std::size_t(n_y)));
  double done = 0;
  std::int32_t y = 0;
  for (std::size_t band = 0; band < n_bands && y < n_y; ++band) {
    const std::int32_t begin = y;
    const double until = total * static_cast<double>(band + 1) / static_cast<double>(n_bands);
    while (y < n_y && (y == begin || done + work[y] / 2 <= until)) done += work[y++];
    if (band + 1 == n_bands) y = n_y;
    result.bands.push_back(static_cast<std::int32_t>(result.rows.size() / 4));
    for (std::int32_t chunk = 0; chunk < n_chunks; ++chunk) {
      std::int32_t flags = ROW_CHUNK_BEGIN;
      for (std::int32_t row = begin > 0 ? begin - 1 : 0; row < y; ++row) {
        const std::size_t at = std::size_t(chunk) * n_y + row;
        if (count[at] == 0) continue;
        // Runs of blocks that are due; what is below a run gives it nothing.
        for (std::int32_t b = first[at], end = b + count[at]; b < end; ++b) {
          if (!is_due(b)) continue;
          const std::int32_t run = b;
          while (b < end && is_due(b)) ++b;
          result.rows.insert(result.rows.end(),
                             {run, b - run, flags | (row < begin ? ROW_SEED : 0), 0});
          flags = 0;
        }
      }
    }
    result.bands.push_back(static_cast<std::int32_t>(result.rows.size() / 4));
  }
  return result;
}

}  // namespace tledface
