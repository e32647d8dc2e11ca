// One tree a surface, searched within what the surfaces before have left. See nearest_surface.hpp.
#include "model/nearest_surface.hpp"

#include "core/threads.hpp"
#include "mesh/bvh.hpp"

namespace tledface {
namespace {

NearestSurface nearest(const std::vector<Bvh>& trees, const Vec3& p, double tolerance) {
  NearestSurface result;
  ClosestPoint best;
  double reach = std::numeric_limits<double>::infinity();
  for (std::size_t s = 0; s < trees.size(); ++s) {
    // A little further than the best so far, to see ties.
    const double limit = reach + tolerance;
    const ClosestPoint hit = trees[s].closest(p, limit * limit);
    if (hit.face < 0) continue;
    const double distance = std::sqrt(hit.distance2);
    if (distance >= reach) {
      result.tied = true;
      continue;
    }
    result.tied = result.surface >= 0 && reach - distance <= tolerance;
    if (result.tied) continue;  // the first of equally near ones
    reach = distance;
    best = hit;
    result.surface = static_cast<std::int32_t>(s);
  }
  if (result.surface < 0) return result;
  const Bvh& tree = trees[result.surface];
  result.face = best.face;
  result.point = best.point;
  result.normal = tree.pseudonormal(best);
  result.distance = dot(p - best.point, result.normal) < 0 ? -reach : reach;
  return result;
}

std::vector<Bvh> trees_of(const std::vector<TriangleMesh>& surfaces) {
  std::vector<Bvh> trees;
  trees.reserve(surfaces.size());
  for (const TriangleMesh& mesh : surfaces) trees.emplace_back(mesh);
  return trees;
}

}  // namespace

std::vector<NearestSurface> nearest_surfaces(const std::vector<TriangleMesh>& surfaces,
                                             const std::vector<Vec3>& points, double tolerance) {
  const std::vector<Bvh> trees = trees_of(surfaces);
  std::vector<NearestSurface> result(points.size());
  parallel_for_chunks(points.size(), 1024, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) result[i] = nearest(trees, points[i], tolerance);
  });
  return result;
}

std::vector<char> segments_meet(const std::vector<TriangleMesh>& surfaces,
                                const std::vector<Vec3>& starts, const std::vector<Vec3>& ends) {
  const std::vector<Bvh> trees = trees_of(surfaces);
  std::vector<char> meets(starts.size(), 0);
  parallel_for_chunks(starts.size(), 1024, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      for (const Bvh& tree : trees)
        if (tree.crosses(starts[i], ends[i])) {
          meets[i] = 1;
          break;
        }
  });
  return meets;
}

}  // namespace tledface
