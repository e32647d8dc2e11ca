// Box tree over triangles: median splits along the longest axis of the centroids' box, four faces a
// leaf, nearer child first. See bvh.hpp.
#include "mesh/bvh.hpp"

#include <numeric>

#include "core/threads.hpp"

namespace tledface {
namespace {

constexpr std::int32_t kLeafFaces = 4;

double box_distance2(const Vec3& p, const Vec3& low, const Vec3& high) {
  const double dx = std::max({low.x - p.x, 0.0, p.x - high.x});
  const double dy = std::max({low.y - p.y, 0.0, p.y - high.y});
  const double dz = std::max({low.z - p.z, 0.0, p.z - high.z});
  return dx * dx + dy * dy + dz * dz;
}

// Weights of the closest point of segment (a, b): of b, in [0, 1].
double segment_weight(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 ab = b - a;
  const double length2 = norm2(ab);
  return length2 > 0 ? std::clamp(dot(p - a, ab) / length2, 0.0, 1.0) : 0.0;
}

// Barycentric weights of the closest point of a triangle by Voronoi regions (Ericson, Real-Time
// Collision Detection 5.1.5); a triangle without area falls back to its nearest edge.
Vec3 closest_weights(const Vec3& p, const std::array<Vec3, 3>& t) {
  const Vec3 ab = t[1] - t[0], ac = t[2] - t[0], ap = p - t[0];
  const double d1 = dot(ab, ap), d2 = dot(ac, ap);
  if (d1 <= 0 && d2 <= 0) return {1, 0, 0};
  const Vec3 bp = p - t[1];
  const double d3 = dot(ab, bp), d4 = dot(ac, bp);
  if (d3 >= 0 && d4 <= d3) return {0, 1, 0};
  const double vc = d1 * d4 - d3 * d2;
  if (vc <= 0 && d1 >= 0 && d3 <= 0 && d1 - d3 > 0) {
    const double v = d1 / (d1 - d3);
    return {1 - v, v, 0};
  }
  const Vec3 cp = p - t[2];
  const double d5 = dot(ab, cp), d6 = dot(ac, cp);
  if (d6 >= 0 && d5 <= d6) return {0, 0, 1};
  const double vb = d5 * d2 - d1 * d6;
  if (vb <= 0 && d2 >= 0 && d6 <= 0 && d2 - d6 > 0) {
    const double w = d2 / (d2 - d6);
    return {1 - w, 0, w};
  }
  const double va = d3 * d6 - d5 * d4;
  if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0 && (d4 - d3) + (d5 - d6) > 0) {
    const double w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
    return {0, 1 - w, w};
  }
  const double sum = va + vb + vc;
  if (sum > 0) return {1 - vb / sum - vc / sum, vb / sum, vc / sum};
  Vec3 best{1, 0, 0};
  double best2 = std::numeric_limits<double>::infinity();
  for (int e = 0; e < 3; ++e) {
    const int f = (e + 1) % 3;
    const double s = segment_weight(p, t[e], t[f]);
    const double distance2 = norm2(p - ((1 - s) * t[e] + s * t[f]));
    if (distance2 < best2) {
      best2 = distance2;
      best = Vec3{};
      best[e] = 1 - s;
      best[f] = s;
    }
  }
  return best;
}

// Whether a + t * run, t in [0, 1], meets a box.
bool segment_meets_box(const Vec3& a, const Vec3& run, const Vec3& low, const Vec3& high) {
  double from = 0, to = 1;
  for (int axis = 0; axis < 3; ++axis) {
    if (run[axis] == 0) {
      if (a[axis] < low[axis] || a[axis] > high[axis]) return false;
      continue;
    }
    const double p = (low[axis] - a[axis]) / run[axis], q = (high[axis] - a[axis]) / run[axis];
    from = std::max(from, std::min(p, q));
    to = std::min(to, std::max(p, q));
  }
  return from <= to;
}

// Moeller & Trumbore 1997, both sides.
bool segment_meets_triangle(const Vec3& a, const Vec3& run, const std::array<Vec3, 3>& t) {
  const Vec3 ab = t[1] - t[0], ac = t[2] - t[0], across = cross(run, ac);
  const double det = dot(ab, across);
  if (det == 0) return false;
  const Vec3 offset = a - t[0];
  const double u = dot(offset, across) / det;
  if (u < 0 || u > 1) return false;
  const Vec3 turned = cross(offset, ab);
  const double v = dot(run, turned) / det;
  if (v < 0 || u + v > 1) return false;
  const double s = dot(ac, turned) / det;
  return s >= 0 && s <= 1;
}

}  // namespace

Bvh::Bvh(TriangleMesh mesh) : mesh_(std::move(mesh)) {
  build();
  compute_normals();
}

void Bvh::build() {
  const auto n = static_cast<std::int32_t>(mesh_.faces.size());
  std::vector<Vec3> centroids(n);
  for (std::int32_t f = 0; f < n; ++f) {
    const Face& face = mesh_.faces[f];
    centroids[f] =
        (1.0 / 3) * (mesh_.vertices[face[0]] + mesh_.vertices[face[1]] + mesh_.vertices[face[2]]);
  }
  order_.resize(n);
  std::iota(order_.begin(), order_.end(), 0);
  struct Task {
    std::int32_t node, begin, end;
  };
  std::vector<Task> tasks{{0, 0, n}};
  nodes_.resize(1);
  while (!tasks.empty()) {
    const Task task = tasks.back();
    tasks.pop_back();
    const Vec3& any = mesh_.vertices[mesh_.faces[order_[task.begin]][0]];
    Vec3 low = any, high = any, middle_low = centroids[order_[task.begin]],
         middle_high = middle_low;
    for (std::int32_t i = task.begin; i < task.end; ++i) {
      for (const auto v : mesh_.faces[order_[i]]) {
        low = min(low, mesh_.vertices[v]);
        high = max(high, mesh_.vertices[v]);
      }
      middle_low = min(middle_low, centroids[order_[i]]);
      middle_high = max(middle_high, centroids[order_[i]]);
    }
    const std::int32_t count = task.end - task.begin;
    if (count <= kLeafFaces) {
      nodes_[task.node] = {low, high, task.begin, count};
      continue;
    }
    const Vec3 extent = middle_high - middle_low;
    const int axis = extent.x >= extent.y && extent.x >= extent.z ? 0
                     : extent.y >= extent.z                       ? 1
                                                                  : 2;
    const std::int32_t middle = task.begin + count / 2;
    std::nth_element(order_.begin() + task.begin, order_.begin() + middle,
                     order_.begin() + task.end, [&](std::int32_t a, std::int32_t b) {
                       const double p = centroids[a][axis], q = centroids[b][axis];
                       return p != q ? p < q : a < b;
                     });
    const auto left = static_cast<std::int32_t>(nodes_.size());
    nodes_[task.node] = {low, high, left, 0};
    nodes_.resize(nodes_.size() + 2);
    tasks.push_back({left, task.begin, middle});
    tasks.push_back({left + 1, middle, task.end});
  }
  corners_.resize(n);
  for (std::int32_t i = 0; i < n; ++i) {
    const Face& face = mesh_.faces[order_[i]];
    corners_[i] = {mesh_.vertices[face[0]], mesh_.vertices[face[1]], mesh_.vertices[face[2]]};
  }
}

void Bvh::compute_normals() {
  face_normals_.resize(mesh_.faces.size());
  vertex_normals_.resize(mesh_.vertices.size());
  edge_normals_.resize(mesh_.faces.size());
  for (std::size_t f = 0; f < mesh_.faces.size(); ++f) {
    const Face& face = mesh_.faces[f];
    const Vec3 p[3] = {mesh_.vertices[face[0]], mesh_.vertices[face[1]], mesh_.vertices[face[2]]};
    face_normals_[f] = unit(cross(p[1] - p[0], p[2] - p[0]));
    for (int c = 0; c < 3; ++c) {
      const double cosine = dot(unit(p[(c + 1) % 3] - p[c]), unit(p[(c + 2) % 3] - p[c]));
      Vec3& normal = vertex_normals_[face[c]];
      normal = normal + std::acos(std::clamp(cosine, -1.0, 1.0)) * face_normals_[f];
    }
  }
  for (Vec3& normal : vertex_normals_) normal = unit(normal);
  const std::vector<Side> sides = sorted_sides(mesh_);
  for (std::size_t begin = 0, end; begin < sides.size(); begin = end) {
    Vec3 sum;
    for (end = begin; end < sides.size() && sides[end].low == sides[begin].low &&
                      sides[end].high == sides[begin].high;
         ++end)
      sum = sum + face_normals_[sides[end].face];
    for (std::size_t s = begin; s < end; ++s) {
      const Face& face = mesh_.faces[sides[s].face];
      for (int c = 0; c < 3; ++c) {
        const std::int32_t a = face[c], b = face[(c + 1) % 3];
        if (std::min(a, b) == sides[s].low && std::max(a, b) == sides[s].high)
          edge_normals_[sides[s].face][c] = unit(sum);
      }
    }
  }
}

ClosestPoint Bvh::closest(const Vec3& p, double limit2, std::int32_t guess) const {
  ClosestPoint hit;
  hit.distance2 = limit2;
  const auto test = [&](const std::array<Vec3, 3>& t, std::int32_t face) {
    const Vec3 w = closest_weights(p, t);
    const Vec3 point = w.x * t[0] + w.y * t[1] + w.z * t[2];
    const double distance2 = norm2(p - point);
    if (distance2 < hit.distance2 ||
        (distance2 == hit.distance2 && (hit.face < 0 || face < hit.face)))
      hit = {distance2, face, point, w};
  };
  if (guess >= 0) {
    const Face& face = mesh_.faces[guess];
    test({mesh_.vertices[face[0]], mesh_.vertices[face[1]], mesh_.vertices[face[2]]}, guess);
  }
  struct Entry {
    std::int32_t node;
    double distance2;
  };
  // Median splits halve the faces, so a tree over 2^31 of them is at most 31 deep.
  std::array<Entry, 64> stack;
  int top = 0;
  stack[top++] = {0, box_distance2(p, nodes_[0].low, nodes_[0].high)};
  while (top > 0) {
    const Entry entry = stack[--top];
    if (entry.distance2 > hit.distance2) continue;
    const Node& node = nodes_[entry.node];
    if (node.count == 0) {
      Entry near{node.first, box_distance2(p, nodes_[node.first].low, nodes_[node.first].high)};
      Entry far{node.first + 1,
                box_distance2(p, nodes_[node.first + 1].low, nodes_[node.first + 1].high)};
      if (far.distance2 < near.distance2) std::swap(near, far);
      if (far.distance2 <= hit.distance2) stack[top++] = far;
      if (near.distance2 <= hit.distance2) stack[top++] = near;
      continue;
    }
    for (std::int32_t i = node.first; i < node.first + node.count; ++i)
      test(corners_[i], order_[i]);
  }
  return hit;
}

bool Bvh::crosses(const Vec3& a, const Vec3& b) const {
  const Vec3 run = b - a;
  std::array<std::int32_t, 64> stack;
  int top = 0;
  stack[top++] = 0;
  while (top > 0) {
    const Node& node = nodes_[stack[--top]];
    if (!segment_meets_box(a, run, node.low, node.high)) continue;
    if (node.count == 0) {
      stack[top++] = node.first;
      stack[top++] = node.first + 1;
    }
    for (std::int32_t i = node.first; i < node.first + node.count; ++i)
      if (segment_meets_triangle(a, run, corners_[i])) return true;
  }
  return false;
}

Vec3 Bvh::pseudonormal(const ClosestPoint& hit) const {
  const Face& face = mesh_.faces[hit.face];
  for (int c = 0; c < 3; ++c)
    if (hit.weights[c] == 1) return vertex_normals_[face[c]];
  for (int c = 0; c < 3; ++c)
    if (hit.weights[(c + 2) % 3] == 0) return edge_normals_[hit.face][c];
  return face_normals_[hit.face];
}

int Bvh::side(const Vec3& p, const ClosestPoint& hit) const {
  const double height = dot(p - hit.point, pseudonormal(hit));
  return height > 0 ? 1 : height < 0 ? -1 : 0;
}

std::vector<ClosestPoint> closest_points(const Bvh& bvh, const std::vector<Vec3>& points) {
  std::vector<ClosestPoint> hits(points.size());
  parallel_for_chunks(points.size(), 1024, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) hits[i] = bvh.closest(points[i]);
  });
  return hits;
}

}  // namespace tledface
