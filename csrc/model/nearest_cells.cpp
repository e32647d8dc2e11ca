// Octree over occupied voxels in Morton order: a level keeps its blocks, in units of their own
// size, and where the children of each begin. See nearest_cells.hpp.
#include "model/nearest_cells.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <numeric>
#include <utility>

#include "core/threads.hpp"

namespace tledface {
namespace {

using Block = std::array<std::int32_t, 3>;

struct Level {
  std::vector<Block> blocks;
  std::vector<std::int32_t> first;  // child of each block and the end; empty on the finest level
};

// Two zero bits after each of the low 21 bits.
std::uint64_t spread_bits(std::int32_t value) {
  std::uint64_t v = static_cast<std::uint64_t>(value) & 0x1FFFFF;
  v = (v | v << 32) & 0x1F00000000FFFF;
  v = (v | v << 16) & 0x1F0000FF0000FF;
  v = (v | v << 8) & 0x100F00F00F00F00F;
  v = (v | v << 4) & 0x10C30C30C30C30C3;
  v = (v | v << 2) & 0x1249249249249249;
  return v;
}

class Octree {
 public:
  Octree(const std::vector<std::int32_t>& cells, const Vec3& voxel) : cells_(cells), voxel_(voxel) {
    const std::size_t n = cells.size() / 3;
    std::vector<std::pair<std::uint64_t, std::int32_t>> code(n);
    for (std::size_t e = 0; e < n; ++e)
      code[e] = {spread_bits(cells[3 * e]) | spread_bits(cells[3 * e + 1]) << 1 |
                     spread_bits(cells[3 * e + 2]) << 2,
                 static_cast<std::int32_t>(e)};
    std::sort(code.begin(), code.end());
    order_.resize(n);
    levels_.emplace_back();
    for (std::size_t i = 0; i < n; ++i) {
      order_[i] = code[i].second;
      levels_.back().blocks.push_back(cell(order_[i]));
    }
    // At least one level above the cells, so that a single cell is no special case.
    do {
      Level up;
      const std::vector<Block>& below = levels_.back().blocks;
      std::size_t kept = 0;
      for (std::size_t i = 0; i < below.size(); ++i) {
        const std::uint64_t parent = code[i].first >> 3;
        if (i == 0 || parent != code[kept - 1].first) {
          up.first.push_back(static_cast<std::int32_t>(i));
          up.blocks.push_back({below[i][0] >> 1, below[i][1] >> 1, below[i][2] >> 1});
          code[kept++].first = parent;
        }
      }
      up.first.push_back(static_cast<std::int32_t>(below.size()));
      levels_.push_back(std::move(up));
    } while (levels_.back().blocks.size() > 1);
    std::reverse(levels_.begin(), levels_.end());
  }

  // `guess`: an element that may be near, which only makes it faster.
  std::pair<std::int32_t, double> nearest(const Vec3& p, std::int32_t guess) const {
    std::int32_t best = guess;
    double best2 = distance2(p, cell(guess), 1);
    const auto finest = static_cast<std::int32_t>(levels_.size()) - 1;
    struct Entry {
      double distance2;
      std::int32_t level, block;
    };
    // Eight children a level, of at most 22 levels.
    std::array<Entry, 8 * 24> stack;
    std::size_t top = 0;
    stack[top++] = {0.0, 0, 0};
    while (top > 0) {
      const Entry entry = stack[--top];
      if (entry.distance2 > best2) continue;
      if (entry.level == finest) {
        const std::int32_t element = order_[entry.block];
        if (entry.distance2 < best2 || element < best) best = element;
        best2 = entry.distance2;
        continue;
      }
      const Level& level = levels_[entry.level];
      const Level& below = levels_[entry.level + 1];
      const double size = static_cast<double>(std::int64_t{1} << (finest - entry.level - 1));
      const std::size_t from = top;
      for (std::int32_t c = level.first[entry.block]; c < level.first[entry.block + 1]; ++c) {
        const double far = distance2(p, below.blocks[c], size);
        if (far > best2) continue;
        // The nearest child comes to lie on top.
        std::size_t place = top++;
        for (; place > from && stack[place - 1].distance2 < far; --place)
          stack[place] = stack[place - 1];
        stack[place] = {far, entry.level + 1, c};
      }
    }
    return {best, best2};
  }

 private:
  Block cell(std::int32_t e) const {
    const std::int32_t* c = &cells_[3 * static_cast<std::size_t>(e)];
    return {c[0], c[1], c[2]};
  }

  double distance2(const Vec3& p, const Block& block, double size) const {
    double sum = 0;
    for (int a = 0; a < 3; ++a) {
      const double low = static_cast<double>(block[a]) * size - p[a];
      const double outside = std::max({low, -low - size, 0.0}) * voxel_[a];
      sum += outside * outside;
    }
    return sum;
  }

  const std::vector<std::int32_t>& cells_;
  const Vec3 voxel_;
  std::vector<std::int32_t> order_;
  std::vector<Level> levels_;  // coarse to fine
};

}  // namespace

NearestCells nearest_cells(const std::vector<std::int32_t>& cells, const Vec3& voxel,
                           const std::vector<Vec3>& points) {
  const Octree tree(cells, voxel);
  NearestCells result;
  result.element.resize(points.size());
  result.distance.resize(points.size());
  parallel_for_chunks(points.size(), 1024, [&](std::size_t begin, std::size_t end) {
    std::int32_t guess = 0;
    for (std::size_t i = begin; i < end; ++i) {
      const auto [element, distance2] = tree.nearest(points[i], guess);
      result.element[i] = guess = element;
      result.distance[i] = std::sqrt(distance2);
    }
  });
  return result;
}

}  // namespace tledface
