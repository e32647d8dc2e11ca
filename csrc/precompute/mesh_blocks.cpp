// Places the nodes and elements of a conforming mesh and writes the rows of its hexahedra; see
// placement.hpp and kernels_cl/layout.cl.
#include <algorithm>
#include <limits>
#include <numeric>
#include <string>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "precompute/layout.hpp"
#include "precompute/placement.hpp"

namespace tledface {
namespace {

constexpr int kMortonBits = 20;  // an axis

std::uint64_t spread(std::uint64_t v) {  // two zero bits behind each of the low 21
  v &= 0x1FFFFF;
  v = (v | v << 32) & 0x1F00000000FFFF;
  v = (v | v << 16) & 0x1F0000FF0000FF;
  v = (v | v << 8) & 0x100F00F00F00F00F;
  v = (v | v << 4) & 0x10C30C30C30C30C3;
  return (v | v << 2) & 0x1249249249249249;
}

// Places of points along the Morton curve through their box: place[i] of point i.
std::vector<std::int64_t> along_curve(const std::vector<double>& points) {
  const std::size_t n = points.size() / 3;
  double low[3], high[3];
  for (int c = 0; c < 3; ++c) low[c] = high[c] = points[c];
  for (std::size_t i = 0; i < points.size(); ++i) {
    low[i % 3] = std::min(low[i % 3], points[i]);
    high[i % 3] = std::max(high[i % 3], points[i]);
  }
  const double widest = std::max({high[0] - low[0], high[1] - low[1], high[2] - low[2]});
  const double scale = widest > 0 ? ((1 << kMortonBits) - 1) / widest : 0;
  std::vector<std::uint64_t> key(n);
  for (std::size_t i = 0; i < n; ++i)
    for (int c = 0; c < 3; ++c)
      key[i] |= spread(static_cast<std::uint64_t>((points[3 * i + c] - low[c]) * scale)) << c;
  std::vector<std::int64_t> sorted(n), place(n);
  std::iota(sorted.begin(), sorted.end(), 0);
  std::stable_sort(sorted.begin(), sorted.end(),
                   [&](std::int64_t a, std::int64_t b) { return key[a] < key[b]; });
  for (std::size_t i = 0; i < n; ++i) place[sorted[i]] = static_cast<std::int64_t>(i);
  return place;
}

}  // namespace

void place_hexahedra(const VoxelModel& model, SolverArrays& arrays) {
  const std::size_t n_elements = model.n_elements(), n_nodes = model.n_nodes(),
                    lanes = arrays.lanes;
  const std::size_t n_blocks = (std::max(n_elements, n_nodes) + lanes - 1) / lanes;
  if (n_blocks > std::size_t(std::numeric_limits<std::int32_t>::max()) / (24 * lanes))
    throw InputError("mesh: " + std::to_string(n_elements) + " elements and " +
                     std::to_string(n_nodes) + " nodes are more than the solver can index");
  arrays.n_blocks = static_cast<std::int32_t>(n_blocks);
  arrays.blocks.assign((n_blocks + 1) * TLED_BLOCK_INTS, 0);
  for (std::size_t b = 0; b <= n_blocks; ++b)
    arrays.blocks[b * TLED_BLOCK_INTS + BLOCK_MATERIAL] = -1;
  arrays.node_slot = along_curve(model.positions);
  std::vector<double> centres(3 * n_elements, 0.0);
  for (std::size_t e = 0; e < n_elements; ++e)
    for (int a = 0; a < 8; ++a)
      for (int c = 0; c < 3; ++c)
        centres[3 * e + c] += model.positions[3 * model.corners[8 * e + a] + c] / 8;
  arrays.element_slot = along_curve(centres);
  arrays.corner_slots.resize(8 * n_elements);
  for (std::size_t i = 0; i < arrays.corner_slots.size(); ++i)
    arrays.corner_slots[i] = arrays.node_slot[model.corners[i]];

  // Lanes without an element read the empty block and have gradients of 0.
  const auto empty = static_cast<std::int32_t>(n_blocks * 3 * lanes);
  arrays.hex_nodes.assign(n_blocks * 8 * lanes, empty);
  arrays.hex_rows.assign(n_blocks * TLED_HEX_ROWS * lanes, 0.0);
  std::vector<std::int32_t> count((n_blocks + 1) * lanes + 1, 0);
  parallel_for_chunks(n_elements, 4096, [&](std::size_t begin, std::size_t end) {
    for (std::size_t e = begin; e < end; ++e) {
      const std::size_t block = arrays.element_slot[e] / lanes,
                        lane = arrays.element_slot[e] % lanes;
      for (int a = 0; a < 8; ++a) {
        const std::size_t slot = arrays.corner_slots[8 * e + a];
        arrays.hex_nodes[(block * 8 + a) * lanes + lane] =
            static_cast<std::int32_t>(slot / lanes * 3 * lanes + slot % lanes);
      }
      const Hexahedron& h = model.hexahedra[e];
      const auto put = [&](int row, double value) {
        arrays.hex_rows[(block * TLED_HEX_ROWS + row) * lanes + lane] = value;
      };
      for (int i = 0; i < 24; ++i) put(HEX_GRADIENT + i, h.gradient[i]);
      for (int i = 0; i < 12; ++i) put(HEX_OFFSET + i, h.offset[i]);
      for (int d = 0; d < 3; ++d) {
        for (int j = 0; j < 3; ++j) put(HEX_AXES + 3 * d + j, h.axes[3 * d + j] / (4 * h.sides[d]));
        put(HEX_SQUARE + d, 16 * h.sides[d] * h.sides[d]);
      }
      const double* L = h.sides.data();
      const double ratios[6] = {L[0] / L[1], L[1] / L[0], L[1] / L[2],
                                L[2] / L[1], L[2] / L[0], L[0] / L[2]};
      for (int i = 0; i < 6; ++i) put(HEX_RATIO + i, ratios[i]);
      put(HEX_VOLUME, h.volume);
    }
  });
  // Corner forces of each node, in the order of element slots.
  std::vector<std::int64_t> element_at(n_blocks * lanes, -1);
  for (std::size_t e = 0; e < n_elements; ++e)
    element_at[arrays.element_slot[e]] = static_cast<std::int64_t>(e);
  for (const std::int64_t slot : arrays.corner_slots) ++count[slot + 1];
  std::partial_sum(count.begin(), count.end(), count.begin());
  arrays.node_begin = count;
  arrays.node_forces.resize(arrays.corner_slots.size());
  for (std::size_t at = 0; at < element_at.size(); ++at) {
    if (element_at[at] < 0) continue;
    for (std::size_t a = 0; a < 8; ++a)
      arrays.node_forces[count[arrays.corner_slots[8 * element_at[at] + a]]++] =
          static_cast<std::int32_t>((at / lanes * 8 + a) * 3 * lanes + at % lanes);
  }
  // Stresses are not scaled by a shape that all share, as those of voxels are.
  arrays.shape.assign(TLED_SHAPE_REALS, 0.0);
  for (int d = 0; d < 3; ++d) arrays.shape[SHAPE_FORCE + d] = arrays.shape[SHAPE_GRADIENT + d] = 1;
}

}  // namespace tledface
