// Triangle surfaces: integrals, welding, edges. See triangle_mesh.hpp.
#include "mesh/triangle_mesh.hpp"

#include <numeric>
#include <tuple>
#include <unordered_map>

namespace tledface {
namespace {

std::int32_t find_root(std::vector<std::int32_t>& parent, std::int32_t i) {
  while (parent[i] != i) i = parent[i] = parent[parent[i]];
  return i;
}

// Joins the larger root to the smaller, so a cluster is represented by its first vertex.
void join(std::vector<std::int32_t>& parent, std::int32_t a, std::int32_t b) {
  a = find_root(parent, a);
  b = find_root(parent, b);
  if (a != b) parent[std::max(a, b)] = std::min(a, b);
}

std::uint64_t cell_key(std::int64_t i, std::int64_t j, std::int64_t k) {
  return static_cast<std::uint64_t>(i) * 0x9E3779B97F4A7C15ull ^
         static_cast<std::uint64_t>(j) * 0xC2B2AE3D27D4EB4Full ^
         static_cast<std::uint64_t>(k) * 0x165667B19E3779F9ull;
}

// Joins sorted vertices nearer than tolerance through a hash grid of that cell size; a hash
// collision only adds a distance test.
void join_near(const std::vector<Vec3>& points, double tolerance,
               std::vector<std::int32_t>& parent) {
  std::unordered_map<std::uint64_t, std::vector<std::int32_t>> grid;
  Vec3 low = points[0];
  for (const Vec3& p : points) low = min(low, p);
  const auto cell = [&](double x) { return static_cast<std::int64_t>(std::floor(x / tolerance)); };
  for (std::int32_t v = 0; v < static_cast<std::int32_t>(points.size()); ++v) {
    if (find_root(parent, v) != v) continue;
    const Vec3& p = points[v];
    const std::int64_t i = cell(p.x - low.x), j = cell(p.y - low.y), k = cell(p.z - low.z);
    for (int n = 0; n < 27; ++n) {
      const auto found = grid.find(cell_key(i + n / 9 - 1, j + n / 3 % 3 - 1, k + n % 3 - 1));
      if (found == grid.end()) continue;
      for (const std::int32_t other : found->second)
        if (norm2(points[other] - p) <= tolerance * tolerance) join(parent, v, other);
    }
    grid[cell_key(i, j, k)].push_back(v);
  }
}

}  // namespace

Bounds bounds(const TriangleMesh& mesh) {
  const Vec3& first = mesh.vertices[mesh.faces[0][0]];
  Bounds box{first, first};
  for (const Face& face : mesh.faces)
    for (const auto v : face) {
      box.low = min(box.low, mesh.vertices[v]);
      box.high = max(box.high, mesh.vertices[v]);
    }
  return box;
}

double surface_area(const TriangleMesh& mesh) {
  double area = 0;
  for (const Face& face : mesh.faces) {
    const Vec3& a = mesh.vertices[face[0]];
    area += 0.5 * norm(cross(mesh.vertices[face[1]] - a, mesh.vertices[face[2]] - a));
  }
  return area;
}

VolumeMoments volume_moments(const TriangleMesh& mesh) {
  // Tetrahedra from the box's middle keep digits when the surface lies far from the origin. For a
  // tetrahedron (0, a, b, c) with s = a+b+c: integral of x = V s/4, of x xT = V (sum aaT + ssT)/20.
  const Bounds box = bounds(mesh);
  const Vec3 middle = 0.5 * (box.low + box.high);
  static constexpr int kAxes[6][2] = {{0, 0}, {1, 1}, {2, 2}, {0, 1}, {1, 2}, {0, 2}};
  double volume = 0;
  Vec3 first;
  std::array<double, 6> second{};
  for (const Face& face : mesh.faces) {
    const Vec3 a = mesh.vertices[face[0]] - middle, b = mesh.vertices[face[1]] - middle,
               c = mesh.vertices[face[2]] - middle, s = a + b + c;
    const double v = dot(a, cross(b, c)) / 6;
    volume += v;
    first = first + (v / 4) * s;
    for (int m = 0; m < 6; ++m) {
      const int p = kAxes[m][0], q = kAxes[m][1];
      second[m] += v / 20 * (a[p] * a[q] + b[p] * b[q] + c[p] * c[q] + s[p] * s[q]);
    }
  }
  VolumeMoments result;
  result.volume = volume;
  const Vec3 offset = volume != 0 ? (1 / volume) * first : Vec3{};
  result.centroid = middle + offset;
  for (int m = 0; m < 6; ++m)
    result.covariance[m] = second[m] - volume * offset[kAxes[m][0]] * offset[kAxes[m][1]];
  return result;
}

void sort_faces(TriangleMesh& mesh) {
  for (Face& face : mesh.faces)
    std::rotate(face.begin(), std::min_element(face.begin(), face.end()), face.end());
  std::sort(mesh.faces.begin(), mesh.faces.end());
}

TriangleMesh weld(const TriangleMesh& mesh, double tolerance) {
  const auto n = static_cast<std::int32_t>(mesh.vertices.size());
  std::vector<char> used(n, 0);
  for (const Face& face : mesh.faces)
    for (const auto v : face) used[v] = 1;
  std::vector<std::int32_t> order;
  for (std::int32_t v = 0; v < n; ++v)
    if (used[v]) order.push_back(v);
  std::sort(order.begin(), order.end(), [&](std::int32_t a, std::int32_t b) {
    const Vec3 &p = mesh.vertices[a], &q = mesh.vertices[b];
    return p == q ? a < b : p < q;
  });

  std::vector<Vec3> points;
  std::vector<std::int32_t> place(n, -1);
  for (const auto v : order) {
    if (points.empty() || !(points.back() == mesh.vertices[v])) points.push_back(mesh.vertices[v]);
    place[v] = static_cast<std::int32_t>(points.size()) - 1;
  }
  std::vector<std::int32_t> parent(points.size());
  std::iota(parent.begin(), parent.end(), 0);
  if (tolerance > 0) join_near(points, tolerance, parent);

  TriangleMesh result;
  std::vector<std::int32_t> number(points.size(), -1);
  for (std::size_t p = 0; p < points.size(); ++p)
    if (find_root(parent, static_cast<std::int32_t>(p)) == static_cast<std::int32_t>(p)) {
      number[p] = static_cast<std::int32_t>(result.vertices.size());
      result.vertices.push_back(points[p]);
    }
  for (const Face& face : mesh.faces) {
    Face corners;
    for (int c = 0; c < 3; ++c) corners[c] = number[find_root(parent, place[face[c]])];
    if (corners[0] != corners[1] && corners[1] != corners[2] && corners[2] != corners[0])
      result.faces.push_back(corners);
  }
  sort_faces(result);
  return result;
}

std::vector<Side> sorted_sides(const TriangleMesh& mesh) {
  std::vector<Side> sides;
  sides.reserve(3 * mesh.faces.size());
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    for (int c = 0; c < 3; ++c) {
      const std::int32_t a = mesh.faces[f][c], b = mesh.faces[f][(c + 1) % 3];
      sides.push_back(
          {std::min(a, b), std::max(a, b), static_cast<std::int32_t>(f), a < b ? 1 : -1});
    }
  std::sort(sides.begin(), sides.end(), [](const Side& s, const Side& t) {
    return std::tie(s.low, s.high, s.face) < std::tie(t.low, t.high, t.face);
  });
  return sides;
}

}  // namespace tledface
