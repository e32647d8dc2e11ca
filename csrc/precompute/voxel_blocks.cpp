// Places nodes and elements of a voxel model: blocks of neighbours in a plane of z, and their
// links; see kernels_cl/layout.cl.
#include <algorithm>
#include <limits>
#include <string>
#include <tuple>
#include <unordered_map>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "precompute/layout.hpp"
#include "precompute/placement.hpp"

namespace tledface {
namespace {

using Key = std::uint64_t;

constexpr int kKeyBits = 20;  // of each of a block's places in x and y, and z
constexpr std::int32_t kLargestIndex = (1 << kKeyBits) - 2;

// Blocks are stored chunk by chunk in x, then row by row in y, then plane by plane in z.
Key block_key(std::int32_t chunk, std::int32_t y, std::int32_t z) {
  return (Key(chunk) << (2 * kKeyBits)) | (Key(y) << kKeyBits) | Key(z);
}

// Rising and each once. Neighbours in the model's order often share a block: they go first.
void make_distinct(std::vector<Key>& keys) {
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
}

// The axes that need fewest blocks of lanes; of those, bands along the longest (x), since a chunk
// is computed twice for each, and columns along the shortest (z).
std::array<int, 3> choose_axis_order(const VoxelModel& model, int width, int height) {
  std::array<std::int32_t, 3> extent{};
  for (std::size_t i = 0; i < model.cells.size(); ++i)
    extent[i % 3] = std::max(extent[i % 3], model.cells[i] + 1);
  // Two axes may change places where blocks are as wide as high, or are rows: once is enough then.
  const auto leads = [&](int a, int b) {
    return extent[a] != extent[b] ? extent[a] > extent[b] : a < b;
  };
  std::vector<std::array<int, 3>> orders;
  for (const std::array<int, 3>& order :
       {std::array<int, 3>{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}})
    if (!(width == height && !leads(order[0], order[1])) &&
        !(height == 1 && !leads(order[1], order[2])))
      orders.push_back(order);
  std::vector<std::size_t> n_blocks(orders.size());
  parallel_for(orders.size(), [&](std::size_t i) {
    const auto& order = orders[i];
    std::vector<Key> keys(model.n_elements());
    for (std::size_t e = 0; e < keys.size(); ++e)
      keys[e] = block_key(model.cells[3 * e + order[0]] / width,
                          model.cells[3 * e + order[1]] / height, model.cells[3 * e + order[2]]);
    make_distinct(keys);
    n_blocks[i] = keys.size();
  });
  std::size_t best = 0;
  for (std::size_t i = 1; i < orders.size(); ++i) {
    const auto rank = [&](std::size_t k) {
      return std::tuple(n_blocks[k], -extent[orders[k][0]], extent[orders[k][2]]);
    };
    if (rank(i) < rank(best)) best = i;
  }
  return orders[best];
}

std::array<std::int32_t, 3> permuted(const std::int32_t* ijk, const std::array<int, 3>& order) {
  return {ijk[order[0]], ijk[order[1]], ijk[order[2]]};
}

}  // namespace

void place_voxels(const VoxelModel& model, const PrecomputeOptions& options, SolverArrays& arrays) {
  const int lanes = arrays.lanes, width = arrays.width, height = lanes / width;
  for (const std::int32_t index : model.cells)
    if (index < 0 || index > kLargestIndex)
      throw InputError("model: grid index " + std::to_string(index) + ", allowed is 0 to " +
                       std::to_string(kLargestIndex));
  const auto order = arrays.order =
      options.axis_order[0] >= 0 ? options.axis_order : choose_axis_order(model, width, height);
  const std::size_t n_elements = model.n_elements(), n_nodes = model.n_nodes();

  // Blocks, in the order of their keys.
  std::vector<Key> keys(n_nodes);
  for (std::size_t n = 0; n < n_nodes; ++n) {
    const auto p = permuted(&model.node_ijk[3 * n], order);
    keys[n] = block_key(p[0] / width, p[1] / height, p[2]);
  }
  std::vector<Key> sorted = keys;
  make_distinct(sorted);
  if (sorted.size() > std::size_t(std::numeric_limits<std::int32_t>::max() / 64))
    throw InputError("model: " + std::to_string(n_nodes) +
                     " nodes are more than the solver can index");
  const std::int32_t n_blocks = arrays.n_blocks = static_cast<std::int32_t>(sorted.size());
  std::unordered_map<Key, std::int32_t> index;
  index.reserve(sorted.size());
  for (std::int32_t b = 0; b < n_blocks; ++b) index.emplace(sorted[b], b);
  const auto find = [&](std::int32_t chunk, std::int32_t row, std::int32_t z) {
    if (chunk < 0 || row < 0 || z < 0) return n_blocks;
    const auto it = index.find(block_key(chunk, row, z));
    return it == index.end() ? n_blocks : it->second;
  };
  const auto lane_of = [&](const std::array<std::int32_t, 3>& p) {
    return p[0] % width + p[1] % height * width;
  };

  arrays.node_slot.resize(n_nodes);
  for (std::size_t n = 0; n < n_nodes; ++n)
    arrays.node_slot[n] =
        std::int64_t(index.at(keys[n])) * lanes + lane_of(permuted(&model.node_ijk[3 * n], order));
  arrays.element_slot.resize(n_elements);
  for (std::size_t e = 0; e < n_elements; ++e) {
    const auto p = permuted(&model.cells[3 * e], order);
    const std::int32_t block = find(p[0] / width, p[1] / height, p[2]);
    if (block == n_blocks)
      throw InputError("model: element " + std::to_string(e) + " has no node at its low corner");
    arrays.element_slot[e] = std::int64_t(block) * lanes + lane_of(p);
  }

  // Links.
  constexpr Key mask = (Key(1) << kKeyBits) - 1;
  arrays.blocks.assign(std::size_t(n_blocks + 1) * TLED_BLOCK_INTS, 0);
  arrays.block_at.resize(n_blocks);
  std::int32_t lowest_plane = std::numeric_limits<std::int32_t>::max();
  for (const Key key : sorted) lowest_plane = std::min(lowest_plane, std::int32_t(key & mask));
  // Places of edges, those of a column one after the other.
  constexpr Key y_and_z = (Key(1) << (2 * kKeyBits)) - 1;
  std::vector<Key> edges(sorted);
  for (Key& key : edges) key &= y_and_z;
  make_distinct(edges);
  arrays.n_edges = TLED_FIRST_EDGE + static_cast<std::int32_t>(edges.size());
  for (std::int32_t b = 0; b <= n_blocks; ++b) {
    std::int32_t* links = &arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS];
    links[BLOCK_MATERIAL] = -1;
    for (const int link : {BLOCK_NEXT_X, BLOCK_NEXT_Y, BLOCK_NEXT_XY, BLOCK_NEXT_Z, BLOCK_PREV_X,
                           BLOCK_PREV_Y, BLOCK_PREV_Z})
      links[link] = n_blocks;
    if (b == n_blocks) break;
    const std::int32_t x = std::int32_t(sorted[b] >> (2 * kKeyBits)),
                       y = std::int32_t((sorted[b] >> kKeyBits) & mask),
                       z = std::int32_t(sorted[b] & mask);
    arrays.block_at[b] = {x, y, z};
    links[BLOCK_NEXT_X] = find(x + 1, y, z);
    links[BLOCK_NEXT_Y] = find(x, y + 1, z);
    links[BLOCK_NEXT_XY] = find(x + 1, y + 1, z);
    links[BLOCK_NEXT_Z] = find(x, y, z + 1);
    links[BLOCK_PREV_X] = find(x - 1, y, z);
    links[BLOCK_PREV_Y] = find(x, y - 1, z);
    links[BLOCK_PREV_Z] = find(x, y, z - 1);
    const auto edge = std::lower_bound(edges.begin(), edges.end(), sorted[b] & y_and_z);
    const auto place = TLED_FIRST_EDGE + static_cast<std::int32_t>(edge - edges.begin());
    links[BLOCK_EDGE] = links[BLOCK_PREV_X] == n_blocks ? -place : place;
    links[BLOCK_PLANE] = z - lowest_plane;
  }

  const double h[3] = {model.voxel[order[0]], model.voxel[order[1]], model.voxel[order[2]]};
  const double volume = h[0] * h[1] * h[2];
  arrays.shape.assign(TLED_SHAPE_REALS, 0.0);
  for (int d = 0; d < 3; ++d) {
    arrays.shape[SHAPE_GRADIENT + d] = 1 / (4 * h[d]);
    arrays.shape[SHAPE_FORCE + d] = volume / (4 * h[d]);
  }
  arrays.shape[SHAPE_RATIO_XY] = h[0] / h[1];
  arrays.shape[SHAPE_RATIO_YX] = h[1] / h[0];
  arrays.shape[SHAPE_RATIO_YZ] = h[1] / h[2];
  arrays.shape[SHAPE_RATIO_ZY] = h[2] / h[1];
  arrays.shape[SHAPE_RATIO_ZX] = h[2] / h[0];
  arrays.shape[SHAPE_RATIO_XZ] = h[0] / h[2];
}

}  // namespace tledface
