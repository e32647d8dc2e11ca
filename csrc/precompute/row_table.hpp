// The rows of blocks that the row kernels walk (kernels_cl/rows.cl), and how they are dealt to
// bands, their work-items.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "precompute/solver_arrays.hpp"

namespace tledface {

struct RowTable {
  std::vector<std::int32_t> rows;       // TLED_RUN of each run of blocks
  std::vector<std::int32_t> row_begin;  // of each cell, and one more
  std::int32_t n_planes = 0, n_y = 0;   // n_y: cells of a chunk
  std::vector<double> work;  // of each cell, chunk by chunk: blocks, those without element less
};

// levels: of each block's nodes; rows then are runs of blocks up to `highest`. Empty: all.
RowTable make_row_table(const SolverArrays& arrays, const std::vector<std::uint8_t>& levels = {},
                        int highest = 0);

// Cuts cells, n_y of which are a chunk, into bands of as many or more so that the slowest is done
// early. A band takes its work over its speed, that of the cells before its first one included
// which it computes once more: a chunk and one.
class RowDealer {
 public:
  RowDealer(const std::vector<double>& work, std::int32_t n_y);
  // First cell and the one behind the last of each band: as many as there are speeds, or chunks.
  std::vector<std::int32_t> deal(const std::vector<double>& speeds) const;
  double work(std::int32_t begin, std::int32_t end) const;
  std::int32_t n_cells() const { return static_cast<std::int32_t>(sums_.size()) - 1; }

 private:
  std::int32_t end_within(std::int32_t begin, double most) const;
  double before(std::int32_t begin) const { return sums_[std::max(begin - n_y_ - 1, 0)]; }

  std::vector<double> sums_;  // of the work before each cell
  std::int32_t n_y_;
};

}  // namespace tledface
