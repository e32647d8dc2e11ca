#include "broad_phase/corner_cone.hpp"

#include <cmath>

namespace tledface {
namespace {

// A cone that is narrower than this, rad, is none.
constexpr double kNarrow = 1e-5;
constexpr double kRounding = 1e-9, kSame = 1e-8;
// Corners of more edges than this are left to the search.
constexpr std::size_t kMostEdges = 64;

}  // namespace

CornerCone corner_cone(const std::vector<Vec3>& edges) {
  CornerCone cone;
  const std::size_t n = edges.size();
  if (n < 3 || n > kMostEdges) return cone;
  const auto is_within = [&](const Vec3& way) {
    for (const Vec3& edge : edges)
      if (dot(edge, way) > kRounding) return false;
    return true;
  };
  // Each of its edges is across two of the triangles'.
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t j = i + 1; j < n; ++j) {
      const Vec3 across = cross(edges[i], edges[j]);
      const double sine = norm(across);
      if (sine < kRounding) continue;
      for (const double sign : {1.0, -1.0}) {
        const Vec3 ray = (sign / sine) * across;
        bool is_new = is_within(ray);
        for (const Vec3& other : cone.rays) is_new = is_new && norm2(ray - other) > kSame * kSame;
        if (is_new) cone.rays.push_back(ray);
      }
    }
  Vec3 sum;
  for (const Vec3& ray : cone.rays) sum = sum + ray;
  cone.middle = unit(sum);
  bool has_room = cone.rays.size() >= 3;
  for (const Vec3& edge : edges) has_room = has_room && dot(edge, cone.middle) < -kNarrow;
  if (!has_room) return {};
  for (std::size_t i = 0; i < n; ++i) {
    int along = 0;
    for (const Vec3& ray : cone.rays) along += dot(edges[i], ray) > -kSame;
    if (along >= 2) cone.bounds.push_back(i);
  }
  return cone;
}

}  // namespace tledface
