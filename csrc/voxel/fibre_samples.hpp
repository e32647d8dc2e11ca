// Which samples of a grid's cells lie inside a closed surface.
//
// Sample (a, b, c) of a cell sits at its low corner + ((a, b, c) + 1/2) h / n, as in voxelise.hpp,
// and is inside where the surface's winding number is not 0.
#pragma once
#include <cstdint>
#include <vector>

#include "voxel/voxelise.hpp"

namespace tledface {

// Cells with at least one sample inside, in lexicographic order of (i, j, k).
struct CellSamples {
  std::vector<std::int32_t> cells;   // 3 a cell
  std::vector<std::uint8_t> inside;  // n^3 a cell, c fastest: 1 inside, else 0
};

CellSamples samples_inside(const TriangleMesh& surface, const VoxelGrid& grid, int samples);

}  // namespace tledface
