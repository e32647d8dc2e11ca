#include "sim/subcycling.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "precompute/layout.hpp"

namespace tledface {
namespace {

// Shares of its bound that a node's step may reach: to go up to it, and to stay there.
constexpr double kRoomy = 0.92, kTaut = 1.0;
// Cost of what a step does with a block of nodes whatever its elements do.
constexpr double kNodeCost = 0.15;

// Levels of the blocks' elements where nodes may reach `share` of their bound.
std::vector<std::uint8_t> element_levels(const VoxelModel& model, const SolverArrays& arrays,
                                         const std::vector<double>& node_squares,
                                         double shortest_step, int n_levels, double share) {
  const auto highest = static_cast<std::uint8_t>(n_levels - 1);
  std::vector<std::uint8_t> at_slot(std::size_t(arrays.n_blocks + 1) * arrays.lanes, highest);
  for (std::size_t n = 0; n < node_squares.size(); ++n) {
    if (!(node_squares[n] > 0)) continue;
    const double ratio = share * 2 / std::sqrt(node_squares[n]) / shortest_step;
    int level = 0;
    while (level < highest && ratio >= static_cast<double>(2 << level)) ++level;
    at_slot[arrays.node_slot[n]] = static_cast<std::uint8_t>(level);
  }
  std::vector<std::uint8_t> levels(arrays.n_blocks, highest);
  for (std::size_t e = 0; e < model.n_elements(); ++e) {
    std::uint8_t& level = levels[arrays.element_slot[e] / arrays.lanes];
    for (int corner = 0; corner < 8; ++corner)
      level = std::min(level, at_slot[arrays.corner_slot(e, corner)]);
  }
  for (std::int32_t b = 0; b < arrays.n_blocks; ++b) {
    const std::int32_t* links = &arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS];
    if (links[BLOCK_LAW_BEGIN] != links[BLOCK_LAW_END]) levels[b] = 0;
  }
  return levels;
}

}  // namespace

BlockLevels same_level(const SolverArrays& arrays) {
  return {1, std::vector<std::uint8_t>(arrays.n_blocks, 0),
          std::vector<std::uint8_t>(arrays.n_blocks, 0)};
}

BlockLevels choose_levels(const VoxelModel& model, const SolverArrays& arrays,
                          const std::vector<double>& node_squares, double shortest_step,
                          int n_levels, const BlockLevels& now) {
  const auto at = [&](double share) {
    return element_levels(model, arrays, node_squares, shortest_step, n_levels, share);
  };
  const auto roomy = at(kRoomy), taut = at(kTaut);
  BlockLevels chosen{n_levels, std::vector<std::uint8_t>(arrays.n_blocks), roomy};
  if (now.n_levels == n_levels)
    for (std::int32_t b = 0; b < arrays.n_blocks; ++b)
      chosen.elements[b] = std::clamp(now.elements[b], roomy[b], taut[b]);
  std::fill(chosen.nodes.begin(), chosen.nodes.end(), static_cast<std::uint8_t>(n_levels - 1));
  for (std::size_t e = 0; e < model.n_elements(); ++e) {
    const std::uint8_t level = chosen.elements[arrays.element_slot[e] / arrays.lanes];
    for (int corner = 0; corner < 8; ++corner) {
      std::uint8_t& nodes = chosen.nodes[arrays.corner_slot(e, corner) / arrays.lanes];
      nodes = std::min(nodes, level);
    }
  }
  return chosen;
}

double relative_cost(const SolverArrays& arrays, const BlockLevels& levels) {
  double cost = 0, whole = 0;
  for (std::int32_t b = 0; b < arrays.n_blocks; ++b) {
    cost += kNodeCost * std::ldexp(1.0, -levels.nodes[b]);
    whole += kNodeCost;
    if (arrays.blocks[std::size_t(b) * TLED_BLOCK_INTS + BLOCK_MATERIAL] < 0) continue;
    cost += std::ldexp(1.0, -levels.elements[b]);
    whole += 1;
  }
  return cost / whole;
}

std::vector<std::int32_t> links_with_levels(const SolverArrays& arrays, const BlockLevels& levels) {
  auto links = arrays.blocks;
  for (std::int32_t b = 0; b < arrays.n_blocks; ++b) {
    std::int32_t* block = &links[std::size_t(b) * TLED_BLOCK_INTS];
    const std::int32_t before = block[BLOCK_PREV_X];
    const int level_before = before < arrays.n_blocks ? levels.nodes[before] : 0;
    block[BLOCK_LEVELS] = ELEMENT_BITS(block[BLOCK_LEVELS]) | levels.nodes[b] |
                          levels.elements[b] << 4 | level_before << 8;
  }
  return links;
}

}  // namespace tledface
