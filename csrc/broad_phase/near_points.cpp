#include "broad_phase/near_points.hpp"

#include <algorithm>
#include <cmath>

#include "broad_phase/sliding_layout.hpp"

namespace tledface {
namespace {

// Cells a margin, unless there would be too many of them along an axis.
constexpr std::int64_t kCells = 4;
constexpr double kMostCells = 256;

}  // namespace

std::vector<std::uint8_t> triangles_near(const SurfaceGrids& surfaces, std::size_t surface,
                                         const std::vector<Vec3>& points, double margin) {
  const std::int32_t first = surfaces.first_triangle[surface];
  const auto n = static_cast<std::size_t>(surfaces.first_triangle[surface + 1] - first);
  std::vector<std::uint8_t> near(n, 0);
  if (points.empty()) return near;
  Vec3 low = points.front(), high = low;
  for (const Vec3& p : points) {
    low = min(low, p);
    high = max(high, p);
  }
  double cell = margin / kCells;
  for (int a = 0; a < 3; ++a) cell = std::max(cell, (high[a] - low[a] + 2 * margin) / kMostCells);
  const auto around = static_cast<std::int64_t>(std::ceil(margin / cell));
  std::int64_t count[3];
  for (int a = 0; a < 3; ++a) {
    low[a] -= static_cast<double>(around) * cell;
    count[a] = static_cast<std::int64_t>((high[a] - low[a]) / cell) + around + 1;
  }
  const auto index = [&](double x, int a) {
    return static_cast<std::int64_t>(std::floor((x - low[a]) / cell));
  };
  // Cells with points, and those around them, axis by axis.
  const std::int64_t stride[3] = {1, count[0], count[0] * count[1]};
  std::vector<std::uint8_t> marked(static_cast<std::size_t>(stride[2] * count[2]), 0);
  for (const Vec3& p : points)
    marked[index(p.x, 0) + index(p.y, 1) * stride[1] + index(p.z, 2) * stride[2]] = 1;
  for (int a = 0; a < 3; ++a) {
    std::vector<std::uint8_t> wider(marked.size(), 0);
    for (std::size_t i = 0; i < marked.size(); ++i) {
      if (!marked[i]) continue;
      const auto place = static_cast<std::int64_t>(i), at = place / stride[a] % count[a];
      for (std::int64_t to = std::max<std::int64_t>(0, at - around);
           to <= std::min(count[a] - 1, at + around); ++to)
        wider[place + (to - at) * stride[a]] = 1;
    }
    marked = std::move(wider);
  }
  for (std::size_t t = 0; t < n; ++t) {
    const double* corners =
        &surfaces.triangles[(static_cast<std::size_t>(first) + t) * TRIANGLE_REALS];
    std::int64_t from[3], to[3];
    for (int a = 0; a < 3; ++a) {
      const auto [least, most] = std::minmax({corners[a], corners[3 + a], corners[6 + a]});
      from[a] = std::max<std::int64_t>(index(least, a), 0);
      to[a] = std::min(index(most, a), count[a] - 1);
    }
    for (std::int64_t z = from[2]; z <= to[2] && !near[t]; ++z)
      for (std::int64_t y = from[1]; y <= to[1] && !near[t]; ++y)
        for (std::int64_t x = from[0]; x <= to[0] && !near[t]; ++x)
          near[t] = marked[x + y * stride[1] + z * stride[2]];
  }
  return near;
}

}  // namespace tledface
