// The occupied voxel nearest to each of many points: a branch and bound over an octree, exact at
// any distance.
#pragma once
#include <cstdint>
#include <vector>

#include "mesh/vec3.hpp"

namespace tledface {

struct NearestCells {
  std::vector<std::int32_t> element;  // the lowest-numbered of equally near ones
  std::vector<double> distance;       // m, 0 inside
};

// `cells`: three grid indices an element, at least one element, 0 to 2^21 - 1 each. `points`: in
// voxels from the corner of cell (0, 0, 0). `voxel`: edge lengths, m.
NearestCells nearest_cells(const std::vector<std::int32_t>& cells, const Vec3& voxel,
                           const std::vector<Vec3>& points);

}  // namespace tledface
