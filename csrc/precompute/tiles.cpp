#include "precompute/tiles.hpp"

#include <algorithm>
#include <limits>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "precompute/layout.hpp"

namespace tledface {
namespace {

// Along an edge; a work-group has a thousand or so.
constexpr int kMostElements = 4096;
// Neighbours along x that stand in one sector of memory, float32; more is as well aligned.
constexpr int kSector = 8;
// The plane below a tile is computed twice, so none is lower than it must be; higher is not worth
// more.
constexpr std::size_t kLeastDepth = 2, kMostDepth = 64;

// The blocks of each (chunk, y), which follow each other in z.
class Rows {
 public:
  explicit Rows(const SolverArrays& arrays) : arrays_(arrays) {
    std::int32_t lowest = std::numeric_limits<std::int32_t>::max(), highest = 0;
    for (const auto& at : arrays.block_at) {
      lowest = std::min(lowest, at[1]);
      highest = std::max(highest, at[1]);
      n_chunks_ = std::max(n_chunks_, at[0] + 1);
    }
    y_begin_ = lowest;
    n_y_ = highest - lowest + 1;
    begin_.assign(std::size_t(n_chunks_) * n_y_ + 1, 0);
    for (const auto& at : arrays.block_at)
      ++begin_[std::size_t(at[0]) * n_y_ + (at[1] - lowest) + 1];
    for (std::size_t i = 1; i < begin_.size(); ++i) begin_[i] += begin_[i - 1];
  }
  std::int32_t n_chunks() const { return n_chunks_; }
  std::int32_t y_begin() const { return y_begin_; }
  std::int32_t y_end() const { return y_begin_ + n_y_; }
  // First block and end; empty outside.
  std::pair<std::int32_t, std::int32_t> blocks(std::int32_t chunk, std::int32_t y) const {
    if (chunk < 0 || chunk >= n_chunks_ || y < y_begin_ || y >= y_end()) return {0, 0};
    const std::size_t at = std::size_t(chunk) * n_y_ + (y - y_begin_);
    return {begin_[at], begin_[at + 1]};
  }
  std::int32_t z(std::int32_t block) const { return arrays_.block_at[block][2]; }

 private:
  const SolverArrays& arrays_;
  std::int32_t n_chunks_ = 0, y_begin_ = 0, n_y_ = 0;
  std::vector<std::int32_t> begin_;
};

struct Tile {
  std::int32_t x, y, z, n_planes;  // its first node; planes of nodes
  bool is_lowest;                  // its columns have no nodes on the plane below, so no elements
};

// Nodes of a block, a bit a lane.
std::vector<std::uint32_t> lanes_with_nodes(const SolverArrays& arrays) {
  std::vector<std::uint32_t> lanes(arrays.n_blocks, 0);
  for (const std::int64_t slot : arrays.node_slot)
    lanes[slot / arrays.lanes] |= 1u << (slot % arrays.lanes);
  return lanes;
}

// Tiles of the rows from y on.
std::vector<Tile> band(const SolverArrays& arrays, const Rows& rows,
                       const std::vector<std::uint32_t>& nodes, const TileShape& shape,
                       std::int32_t y) {
  const std::int32_t lanes = arrays.lanes, width = shape.width - 1,
                     y_end = std::min(y + shape.rows - 1, rows.y_end());
  std::vector<std::uint32_t> at_x(rows.n_chunks(), 0);
  for (std::int32_t chunk = 0; chunk < rows.n_chunks(); ++chunk)
    for (std::int32_t row = y; row < y_end; ++row) {
      const auto [begin, end] = rows.blocks(chunk, row);
      for (std::int32_t block = begin; block < end; ++block) at_x[chunk] |= nodes[block];
    }
  std::vector<Tile> tiles;
  std::vector<std::int32_t> planes;
  for (std::int32_t x = 0; x < rows.n_chunks() * lanes;) {
    if (!(at_x[x / lanes] >> (x % lanes) & 1)) {
      ++x;
      continue;
    }
    // Whole sectors of memory, where a tile's columns are.
    if (width % kSector == 0) x -= x % kSector;
    planes.clear();
    for (std::int32_t chunk = x / lanes; chunk <= (x + width - 1) / lanes; ++chunk) {
      std::uint32_t within = 0;
      for (std::int32_t lane = 0; lane < lanes; ++lane)
        if (const std::int32_t at = chunk * lanes + lane; at >= x && at < x + width)
          within |= 1u << lane;
      for (std::int32_t row = y; row < y_end; ++row) {
        const auto [begin, end] = rows.blocks(chunk, row);
        for (std::int32_t block = begin; block < end; ++block)
          if (nodes[block] & within) planes.push_back(rows.z(block));
      }
    }
    std::sort(planes.begin(), planes.end());
    planes.erase(std::unique(planes.begin(), planes.end()), planes.end());
    for (std::size_t i = 0; i < planes.size();) {
      // The next tile's first plane is computed twice: a gap of one is cheaper walked through.
      std::size_t end = i + 1;
      while (end < planes.size() && planes[end] <= planes[end - 1] + 2 &&
             planes[end] - planes[i] < shape.depth)
        ++end;
      tiles.push_back({x, y, planes[i], planes[end - 1] - planes[i] + 1,
                       i == 0 || planes[i - 1] + 1 < planes[i]});
      i = end;
    }
    x += width;
  }
  return tiles;
}

}  // namespace

int tile_depth(const SolverArrays& arrays, const TileShape& shape, std::size_t n_items) {
  // Work-items that bring the nodes of the last column and row are among those of the elements.
  if (shape.width < 2 || shape.rows < 2 || shape.width + shape.rows < 5 || shape.depth < 0 ||
      shape.width > kMostElements || shape.rows > kMostElements)
    throw InputError("tile: got " + std::to_string(shape.width) + " x " +
                     std::to_string(shape.rows) + " elements and " + std::to_string(shape.depth) +
                     " planes; allowed are 2 x 3 or 3 x 2 to " + std::to_string(kMostElements) +
                     " x " + std::to_string(kMostElements) + ", and 0 (chosen) or more");
  if (shape.depth) return shape.depth;
  const std::size_t n_tiles =
                        std::max<std::size_t>(1, n_items / (std::size_t(shape.width) * shape.rows)),
                    columns = std::size_t(shape.width - 1) * (shape.rows - 1),
                    planes = std::size_t(arrays.n_blocks) * arrays.lanes / columns;
  return static_cast<int>(std::clamp(planes / n_tiles, kLeastDepth, kMostDepth));
}

std::size_t Tiles::size() const { return tiles.size() / TLED_TILE_INTS; }

Tiles make_tiles(const SolverArrays& arrays, const TileShape& shape) {
  const Rows rows(arrays);
  const auto nodes = lanes_with_nodes(arrays);
  const std::int32_t lanes = arrays.lanes, step = shape.rows - 1;
  const auto n_bands = static_cast<std::size_t>((rows.y_end() - rows.y_begin() + step - 1) / step);
  std::vector<std::vector<Tile>> bands(n_bands);
  parallel_for_chunks(n_bands, 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      bands[i] =
          band(arrays, rows, nodes, shape, rows.y_begin() + static_cast<std::int32_t>(i) * step);
  });
  std::vector<Tile> all;
  for (const auto& tiles : bands) all.insert(all.end(), tiles.begin(), tiles.end());
  // Groups begin in this order: the highest first, so that low ones fill the end; those of a height
  // as they lie.
  std::sort(all.begin(), all.end(), [&](const Tile& a, const Tile& b) {
    if (a.n_planes != b.n_planes) return a.n_planes > b.n_planes;
    const std::int32_t ca = a.x / lanes, cb = b.x / lanes;
    if (ca != cb) return ca < cb;
    if (a.y != b.y) return a.y < b.y;
    return a.z != b.z ? a.z < b.z : a.x < b.x;
  });

  const std::int32_t across = TLED_TILE_BLOCKS(shape.width, lanes);
  const std::int64_t plane_places = std::int64_t(shape.rows + 1) * across;
  Tiles result;
  std::int64_t n_places = 0;
  for (const Tile& tile : all) {
    const std::int32_t first = tile.x - 1 + lanes;  // of its elements, a chunk on: not negative
    result.tiles.insert(result.tiles.end(),
                        {static_cast<std::int32_t>(n_places), tile.n_planes, first % lanes,
                         first / lanes - 1, tile.is_lowest ? 1 : 0});
    n_places += (tile.n_planes + 2) * plane_places;
  }
  if (n_places > std::numeric_limits<std::int32_t>::max())
    throw InputError("tile: the model has more places than tiles can index; use kernels='gather'");
  result.places.assign(n_places, arrays.n_blocks);
  parallel_for_chunks(all.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Tile& tile = all[i];
      const std::int32_t chunk = result.tiles[i * TLED_TILE_INTS + TILE_CHUNK];
      std::int32_t* places = &result.places[result.tiles[i * TLED_TILE_INTS + TILE_PLACES]];
      for (std::int32_t row = 0; row <= shape.rows; ++row)
        for (std::int32_t k = 0; k < across; ++k) {
          auto [block, last] = rows.blocks(chunk + k, tile.y - 1 + row);
          block = static_cast<std::int32_t>(
              std::lower_bound(arrays.block_at.begin() + block, arrays.block_at.begin() + last,
                               tile.z - 1,
                               [](const auto& at, std::int32_t z) { return at[2] < z; }) -
              arrays.block_at.begin());
          for (; block < last && rows.z(block) <= tile.z + tile.n_planes; ++block)
            places[(rows.z(block) - tile.z + 1) * plane_places + row * across + k] = block;
        }
    }
  });
  return result;
}

}  // namespace tledface
