#include "broad_phase/uniform_grid.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "broad_phase/sliding_layout.hpp"
#include "core/error.hpp"
#include "core/threads.hpp"

namespace tledface {
namespace {

// Edge of a cell over the mean edge of a triangle, and the most cells for each triangle: a search
// looks at a few cells with a few triangles each.
constexpr double kCellOverEdge = 1.0;
constexpr double kMostCells = 4.0;

// What the radius of a ball about a triangle is widened by, for the device's rounding.
constexpr double kRounding = 1.0001;

Vec3 permuted(const Vec3& v, const std::array<int, 3>& order) {
  return {v[order[0]], v[order[1]], v[order[2]]};
}

// Angle-weighted pseudonormals (Baerentzen & Aanaes 2005): of faces, sides (the sum of the two
// faces') and vertices.
struct Pseudonormals {
  std::vector<Vec3> face, vertex;
  std::vector<std::array<Vec3, 3>> side;
};

Pseudonormals pseudonormals_of(const TriangleMesh& mesh) {
  Pseudonormals n;
  n.vertex.resize(mesh.vertices.size());
  n.side.resize(mesh.faces.size());
  for (const Face& face : mesh.faces) {
    const Vec3 &a = mesh.vertices[face[0]], &b = mesh.vertices[face[1]],
               &c = mesh.vertices[face[2]];
    n.face.push_back(unit(cross(b - a, c - a)));
    for (int corner = 0; corner < 3; ++corner) {
      const Vec3 p = unit(mesh.vertices[face[(corner + 1) % 3]] - mesh.vertices[face[corner]]),
                 q = unit(mesh.vertices[face[(corner + 2) % 3]] - mesh.vertices[face[corner]]);
      const double angle = std::acos(std::clamp(dot(p, q), -1.0, 1.0));
      n.vertex[face[corner]] = n.vertex[face[corner]] + angle * n.face.back();
    }
  }
  for (Vec3& v : n.vertex) v = unit(v);
  const auto sides = sorted_sides(mesh);
  for (std::size_t begin = 0; begin < sides.size();) {
    std::size_t end = begin;
    Vec3 sum;
    for (; end < sides.size() && sides[end].low == sides[begin].low &&
           sides[end].high == sides[begin].high;
         ++end)
      sum = sum + n.face[sides[end].face];
    for (; begin < end; ++begin) {
      const Face& face = mesh.faces[sides[begin].face];
      for (int corner = 0; corner < 3; ++corner)
        if (std::min(face[corner], face[(corner + 1) % 3]) == sides[begin].low &&
            std::max(face[corner], face[(corner + 1) % 3]) == sides[begin].high)
          n.side[sides[begin].face][corner] = unit(sum);
    }
  }
  return n;
}

double squared_distance(const Vec3& p, const Vec3& a, const Vec3& b, const Vec3& c) {
  // The projection where it falls inside, else the nearest side.
  const Vec3 ab = b - a, ac = c - a, normal = cross(ab, ac);
  const double area2 = norm2(normal);
  if (area2 > 0) {
    const Vec3 ap = p - a;
    const double v = dot(cross(ap, ac), normal) / area2, w = dot(cross(ab, ap), normal) / area2;
    if (v >= 0 && w >= 0 && v + w <= 1) return dot(ap, normal) * dot(ap, normal) / area2;
  }
  double least = std::numeric_limits<double>::infinity();
  const Vec3 corner[3] = {a, b, c};
  for (int s = 0; s < 3; ++s) {
    const Vec3 from = corner[s], along = corner[(s + 1) % 3] - from;
    const double length2 = norm2(along);
    const double t = length2 > 0 ? std::clamp(dot(p - from, along) / length2, 0.0, 1.0) : 0.0;
    least = std::min(least, norm2(p - (from + t * along)));
  }
  return least;
}

}  // namespace

SurfaceGrids make_surface_grids(const std::vector<TriangleMesh>& surfaces, const Vec3& centre,
                                const std::array<int, 3>& order) {
  SurfaceGrids result;
  std::int32_t first_triangle = 0;
  for (const TriangleMesh& mesh : surfaces) {
    const Pseudonormals normals = pseudonormals_of(mesh);
    std::vector<std::int32_t> faces;
    double edges = 0;
    for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
      if (!(norm2(normals.face[f]) > 0)) continue;  // no area: its neighbours cover it
      faces.push_back(static_cast<std::int32_t>(f));
      for (int c = 0; c < 3; ++c)
        edges +=
            norm(mesh.vertices[mesh.faces[f][c]] - mesh.vertices[mesh.faces[f][(c + 1) % 3]]) / 3;
    }
    if (faces.empty()) throw InputError("sliding: a surface has no triangle with an area");
    Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
    std::vector<std::array<Vec3, 3>> corners;
    for (const std::int32_t f : faces) {
      std::array<Vec3, 3> corner;
      for (int c = 0; c < 3; ++c) {
        corner[c] = permuted(mesh.vertices[mesh.faces[f][c]] - centre, order);
        low = min(low, corner[c]);
        high = max(high, corner[c]);
      }
      corners.push_back(corner);
      const auto put = [&](const Vec3& v) {
        for (int a = 0; a < 3; ++a) result.triangles.push_back(v[a]);
      };
      for (const Vec3& v : corner) put(v);
      put(permuted(normals.face[f], order));
      for (const Vec3& v : normals.side[f]) put(permuted(v, order));
      for (int c = 0; c < 3; ++c) put(permuted(normals.vertex[mesh.faces[f][c]], order));
      const Vec3 middle = (1.0 / 3.0) * (corner[0] + corner[1] + corner[2]);
      double radius = 0;
      for (const Vec3& v : corner) radius = std::max(radius, norm(v - middle));
      put(middle);
      result.triangles.push_back(kRounding * radius);
    }
    const Vec3 size = high - low;
    double cell = kCellOverEdge * edges / static_cast<double>(faces.size());
    std::array<std::int64_t, 3> count;
    for (;;) {
      double cells = 1;
      for (int a = 0; a < 3; ++a) {
        count[a] = static_cast<std::int64_t>(size[a] / cell) + 1;
        cells *= static_cast<double>(count[a]);
      }
      if (cells <= kMostCells * static_cast<double>(faces.size()) + 64) break;
      cell *= 1.26;
    }
    for (int a = 0; a < 3; ++a) result.grids.push_back(static_cast<std::int32_t>(count[a]));
    result.grids.push_back(static_cast<std::int32_t>(result.cell_begin.size()));
    for (int a = 0; a < 3; ++a) result.grid_reals.push_back(low[a]);
    result.grid_reals.push_back(cell);

    const std::size_t n_cells = static_cast<std::size_t>(count[0] * count[1] * count[2]);
    std::vector<std::vector<std::int32_t>> inside(n_cells);
    // A box takes in cells that it touches: the device's rounding may put a point on either side.
    const double slack = 1e-4 * cell;
    for (std::size_t f = 0; f < corners.size(); ++f) {
      std::int64_t from[3], to[3];
      for (int a = 0; a < 3; ++a) {
        const auto [least, most] =
            std::minmax({corners[f][0][a], corners[f][1][a], corners[f][2][a]});
        const auto index = [&](double x) {
          return std::clamp<std::int64_t>(
              static_cast<std::int64_t>(std::floor((x - low[a]) / cell)), 0, count[a] - 1);
        };
        from[a] = index(least - slack);
        to[a] = index(most + slack);
      }
      for (std::int64_t z = from[2]; z <= to[2]; ++z)
        for (std::int64_t y = from[1]; y <= to[1]; ++y)
          for (std::int64_t x = from[0]; x <= to[0]; ++x)
            inside[(z * count[1] + y) * count[0] + x].push_back(first_triangle +
                                                                static_cast<std::int32_t>(f));
    }
    for (const auto& list : inside) {
      result.cell_begin.push_back(static_cast<std::int32_t>(result.cell_triangles.size()));
      result.cell_triangles.insert(result.cell_triangles.end(), list.begin(), list.end());
    }
    // The end of the last cell: surfaces do not share it, cells are read in pairs.
    result.cell_begin.push_back(static_cast<std::int32_t>(result.cell_triangles.size()));
    first_triangle += static_cast<std::int32_t>(faces.size());
    result.first_triangle.push_back(first_triangle);
  }
  return result;
}

std::vector<NearestTriangle> nearest_by_brute_force(const TriangleMesh& surface,
                                                    const std::vector<Vec3>& points) {
  std::vector<NearestTriangle> result(points.size());
  parallel_for_chunks(points.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      for (std::size_t f = 0; f < surface.faces.size(); ++f) {
        const Face& face = surface.faces[f];
        const double square =
            squared_distance(points[i], surface.vertices[face[0]], surface.vertices[face[1]],
                             surface.vertices[face[2]]);
        if (result[i].face < 0 || square < result[i].square)
          result[i] = {static_cast<std::int32_t>(f), square};
      }
  });
  return result;
}

}  // namespace tledface
