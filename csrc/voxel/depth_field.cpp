// Depth and layers from the closest point of the outer surface. See depth_field.hpp.
#include "voxel/depth_field.hpp"

#include <algorithm>

namespace tledface {
namespace {

bool holds(const Bounds& box, const Vec3& p) {
  return min(box.low, p) == box.low && max(box.high, p) == box.high;
}

}  // namespace

DepthField::DepthField(TriangleMesh outer, std::vector<std::vector<double>> boundaries, double cap,
                       std::vector<DepthBox> local_caps)
    : outer_(std::move(outer)),
      boundaries_(std::move(boundaries)),
      cap_(cap),
      local_caps_(std::move(local_caps)) {
  for (const auto& layer : boundaries_) {
    shallowest_.push_back(*std::min_element(layer.begin(), layer.end()));
    deepest_.push_back(*std::max_element(layer.begin(), layer.end()));
  }
}

Depth DepthField::at(const Vec3& p, bool inside, const ClosestPoint& hit, double rounding) const {
  const double distance = std::sqrt(hit.distance2);
  Depth result{inside ? distance : -distance, {}};
  // Within rounding of the surface the way to it has no direction: the face has.
  if (distance > rounding)
    result.gradient = (1 / result.depth) * (p - hit.point);
  else
    result.gradient = -1.0 * outer_.face_normal(hit.face);
  return result;
}

void DepthField::find_ends(const ClosestPoint& hit, std::vector<double>& ends) const {
  ends.clear();
  for (const auto& layer : boundaries_) {
    if (layer.size() == 1) {
      ends.push_back(layer[0]);
      continue;
    }
    const Face& face = outer_.mesh().faces[hit.face];
    ends.push_back(hit.weights.x * layer[face[0]] + hit.weights.y * layer[face[1]] +
                   hit.weights.z * layer[face[2]]);
  }
}

bool DepthField::one_layer(double low, double high, std::size_t& layer) const {
  layer = 0;
  while (layer < deepest_.size() && low >= deepest_[layer]) ++layer;
  return layer == deepest_.size() || high < shallowest_[layer];
}

double DepthField::cap_at(const Vec3& p) const {
  double cap = cap_;
  for (const DepthBox& local : local_caps_)
    if (holds(local.box, p)) cap = local.cap;
  return cap;
}

std::array<double, 2> DepthField::cap_range(const Bounds& box) const {
  std::array<double, 2> range{cap_, cap_};
  for (const DepthBox& local : local_caps_) {
    const Vec3 low = max(local.box.low, box.low), high = min(local.box.high, box.high);
    if (low.x > high.x || low.y > high.y || low.z > high.z) continue;
    const bool whole = low == box.low && high == box.high;
    range[0] = whole ? local.cap : std::min(range[0], local.cap);
    range[1] = whole ? local.cap : std::max(range[1], local.cap);
  }
  return range;
}

}  // namespace tledface
