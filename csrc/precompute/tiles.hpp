// Deals node columns to tiles, the work-groups of kernels_cl/tile.cl.
#pragma once
#include <cstdint>
#include <vector>

#include "precompute/solver_arrays.hpp"

namespace tledface {

// Elements of a tile in x and y; planes of nodes in z at most. It owns one column of nodes less in
// each of x and y.
struct TileShape {
  int width = 0, rows = 0, depth = 0;
};

// The arrays `tiles` and `places` of kernels_cl/layout.cl.
struct Tiles {
  std::vector<std::int32_t> tiles, places;
  std::size_t n_elements = 0;  // computed a step, those of several tiles as often, and empty ones
  std::size_t size() const;
};

// A tile begins where nodes begin: they cover each band of rows from its first node on, and leave
// out planes without one. In the order of blocks in memory.
Tiles make_tiles(const SolverArrays& arrays, const TileShape& shape);

}  // namespace tledface
