// The nearest of several triangle surfaces to each of many points: which, where, how far, and on
// which side.
#pragma once
#include <cstdint>
#include <vector>

#include "mesh/triangle_mesh.hpp"

namespace tledface {

struct NearestSurface {
  std::int32_t surface = -1;  // the first of equally near ones
  std::int32_t face = -1;
  double distance = 0;  // m, positive on the side that the normal points to
  Vec3 point;           // closest point, m
  Vec3 normal;          // unit pseudonormal there (see mesh/bvh.hpp)
  bool tied = false;    // another surface is as near, to within the tolerance
};

// Surfaces may be open; vertices that faces share must be shared by index (see weld). `tolerance`
// is in m.
std::vector<NearestSurface> nearest_surfaces(const std::vector<TriangleMesh>& surfaces,
                                             const std::vector<Vec3>& points, double tolerance);

// Which of the segments from starts[i] to ends[i] meet any of the surfaces.
std::vector<char> segments_meet(const std::vector<TriangleMesh>& surfaces,
                                const std::vector<Vec3>& starts, const std::vector<Vec3>& ends);

}  // namespace tledface
