// Deals node columns to tiles, the work-groups of kernels_cl/tile.cl.
#pragma once
#include <cstdint>
#include <vector>

#include "precompute/solver_arrays.hpp"

namespace tledface {

// Elements of a tile in x and y; planes of nodes in z at most. It owns one column of nodes less in
// each of x and y.
struct TileShape {
  int width = 16, rows = 8, depth = 0;  // depth 0: by how many work-items there should be
};

// The arrays `tiles` and `places` of kernels_cl/layout.cl.
struct Tiles {
  std::vector<std::int32_t> tiles, places;
  std::size_t size() const;
};

// Planes of nodes a tile for about n_items work-items, one an element of a plane; at least 2, at
// most 64. InputError for a shape that cannot be.
int tile_depth(const SolverArrays& arrays, const TileShape& shape, std::size_t n_items);

// A tile begins where nodes begin: they cover each band of rows from its first node on, and leave
// out planes without one. The highest first, those of a height in the order of blocks in memory.
Tiles make_tiles(const SolverArrays& arrays, const TileShape& shape);

}  // namespace tledface
