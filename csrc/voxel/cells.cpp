// Cell sets by a sorted list and binary search along columns. See cells.hpp.
#include "voxel/cells.hpp"

#include <algorithm>
#include <array>
#include <functional>

namespace tledface {
namespace {

using Cell = std::array<std::int32_t, 3>;

// Finds cells through the start of each (i, j) column of the bounding box of i and j.
class CellIndex {
 public:
  explicit CellIndex(const std::vector<std::int32_t>& cells) : cells_(cells) {
    const std::size_t n = cells.size() / 3;
    if (n == 0) return;
    low_ = {cells[0], cells[1]};
    std::array<std::int32_t, 2> high = low_;
    for (std::size_t e = 0; e < n; ++e)
      for (int a = 0; a < 2; ++a) {
        low_[a] = std::min(low_[a], cells[3 * e + a]);
        high[a] = std::max(high[a], cells[3 * e + a]);
      }
    for (int a = 0; a < 2; ++a) size_[a] = static_cast<std::int64_t>(high[a]) - low_[a] + 1;
    begin_.assign(static_cast<std::size_t>(size_[0] * size_[1]) + 1, 0);
    for (std::size_t e = 0; e < n; ++e) ++begin_[column(cells[3 * e], cells[3 * e + 1]) + 1];
    for (std::size_t c = 1; c < begin_.size(); ++c) begin_[c] += begin_[c - 1];
  }

  // Index of the cell, or -1.
  std::int64_t find(std::int64_t i, std::int64_t j, std::int64_t k) const {
    if (begin_.empty() || i < low_[0] || i >= low_[0] + size_[0] || j < low_[1] ||
        j >= low_[1] + size_[1])
      return -1;
    std::size_t from = begin_[column(i, j)], to = begin_[column(i, j) + 1];
    while (from < to) {
      const std::size_t middle = (from + to) / 2;
      if (cells_[3 * middle + 2] < k)
        from = middle + 1;
      else
        to = middle;
    }
    return from < begin_[column(i, j) + 1] && cells_[3 * from + 2] == k
               ? static_cast<std::int64_t>(from)
               : -1;
  }

 private:
  std::size_t column(std::int64_t i, std::int64_t j) const {
    return static_cast<std::size_t>((i - low_[0]) * size_[1] + (j - low_[1]));
  }

  const std::vector<std::int32_t>& cells_;
  std::array<std::int32_t, 2> low_{};
  std::array<std::int64_t, 2> size_{};
  std::vector<std::size_t> begin_;
};

}  // namespace

CleanedCells clean_cells(const std::vector<std::int32_t>& cells, int min_neighbours,
                         bool largest_only) {
  const std::size_t n = cells.size() / 3;
  CleanedCells result;
  result.keep.assign(n, 1);
  const CellIndex index(cells);
  std::vector<std::array<std::int64_t, 6>> neighbours(n);
  for (std::size_t e = 0; e < n; ++e)
    for (int side = 0; side < 6; ++side) {
      Cell c{cells[3 * e], cells[3 * e + 1], cells[3 * e + 2]};
      c[side / 2] += side % 2 ? 1 : -1;
      neighbours[e][side] = index.find(c[0], c[1], c[2]);
    }

  std::vector<std::size_t> stack;
  const auto is_loose = [&](std::size_t e) {
    int count = 0;
    for (const auto other : neighbours[e]) count += other >= 0 && result.keep[other];
    return count < min_neighbours;
  };
  for (std::size_t e = 0; e < n; ++e) stack.push_back(e);
  while (!stack.empty()) {
    const std::size_t e = stack.back();
    stack.pop_back();
    if (!result.keep[e] || !is_loose(e)) continue;
    result.keep[e] = 0;
    ++result.loose;
    for (const auto other : neighbours[e])
      if (other >= 0 && result.keep[other]) stack.push_back(static_cast<std::size_t>(other));
  }

  std::vector<std::int32_t> part(n, -1);
  std::vector<std::size_t> sizes;
  for (std::size_t seed = 0; seed < n; ++seed) {
    if (!result.keep[seed] || part[seed] >= 0) continue;
    const auto number = static_cast<std::int32_t>(sizes.size());
    sizes.push_back(0);
    part[seed] = number;
    stack.push_back(seed);
    while (!stack.empty()) {
      const std::size_t e = stack.back();
      stack.pop_back();
      ++sizes[number];
      for (const auto other : neighbours[e])
        if (other >= 0 && result.keep[other] && part[other] < 0) {
          part[other] = number;
          stack.push_back(static_cast<std::size_t>(other));
        }
    }
  }
  if (sizes.empty()) return result;
  const auto largest =
      static_cast<std::int32_t>(std::max_element(sizes.begin(), sizes.end()) - sizes.begin());
  for (std::size_t e = 0; e < n; ++e)
    if (largest_only && part[e] != largest) result.keep[e] = 0;
  sizes.erase(sizes.begin() + largest);
  std::sort(sizes.begin(), sizes.end(), std::greater<>());
  result.smaller = std::move(sizes);
  return result;
}

}  // namespace tledface
