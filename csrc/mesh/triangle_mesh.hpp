// A triangle surface and its integral properties. Lengths in metres.
#pragma once
#include <array>
#include <cstdint>
#include <utility>
#include <vector>

#include "mesh/vec3.hpp"

namespace tledface {

using Face = std::array<std::int32_t, 3>;

struct TriangleMesh {
  std::vector<Vec3> vertices;
  std::vector<Face> faces;
};

struct Bounds {
  Vec3 low, high;
};

struct VolumeMoments {
  double volume = 0;  // m^3, positive where faces wind counter-clockwise from outside
  Vec3 centroid;      // m
  std::array<double, 6> covariance;  // xx yy zz xy yz xz about the centroid, times volume, m^5
};

// Bounding box of the vertices that faces use; the mesh must have a face.
Bounds bounds(const TriangleMesh& mesh);

double surface_area(const TriangleMesh& mesh);

// Exact integrals over the enclosed volume (sum of signed tetrahedra).
VolumeMoments volume_moments(const TriangleMesh& mesh);

// Merges vertices no farther apart than tolerance (0: equal ones), transitively; drops unused ones
// and faces that lose a corner. Vertices come out in lexicographic order, faces start at their
// lowest vertex and are sorted, so the result does not depend on the order of the input.
TriangleMesh weld(const TriangleMesh& mesh, double tolerance);

// The same surface in canonical order: see weld.
void sort_faces(TriangleMesh& mesh);

// One entry per side of each face: (low vertex, high vertex), face, +1 if the face runs low ->
// high.
struct Side {
  std::int32_t low, high, face;
  int direction;
};

// All sides sorted by (low, high, face).
std::vector<Side> sorted_sides(const TriangleMesh& mesh);

}  // namespace tledface
