// Inside test by winding numbers along lattice columns.
//
// A column of samples runs along z at one (x, y). Every face whose projection covers (x, y) crosses
// it once, +1 where the column enters the volume and -1 where it leaves; a sample's winding number
// is the sum of the crossings at or below it. Coverage is decided per directed edge: an edge
// crosses the line x = x_s where its ends lie on different sides (x > x_s or not), its crossing y
// and z are computed from the two vertices in index order, and a face covers the half-open y
// interval between its two crossing edges. Both faces of an edge therefore take the same decision
// from the same number, so on a closed surface the crossings of every column sum to zero exactly,
// whatever the rounding and however samples fall on vertices, edges or upright faces.
#pragma once
#include <cstdint>
#include <vector>

#include "mesh/triangle_mesh.hpp"

namespace tledface {

// Samples at first + (a, b, c) * step, 0 <= (a, b, c) < count.
struct SampleLattice {
  Vec3 first, step;
  std::array<std::int64_t, 3> count;
};

struct Crossing {
  std::int32_t sample;  // first sample along z at or above the face
  std::int32_t sign;    // +1 entering, -1 leaving
};

// Crossings of the columns of one slab: of column (a - first row, b), items begin[column] ...
struct SlabCrossings {
  std::vector<std::uint32_t> begin;
  std::vector<Crossing> items;

 private:
  friend class ColumnScanner;
  struct Hit {
    std::uint32_t column;
    Crossing crossing;
  };
  std::vector<Hit> hits_;
};

// Scans a surface in slabs of rows_per_slab lattice rows along x; the surface must outlive it.
class ColumnScanner {
 public:
  ColumnScanner(const TriangleMesh& mesh, const SampleLattice& lattice, int rows_per_slab);

  // Safe to call from several threads with different outputs.
  void scan(std::int64_t slab, SlabCrossings& out) const;

  // Whether any face may reach the slab.
  bool reaches(std::int64_t slab) const { return begin_[slab] != begin_[slab + 1]; }

 private:
  const TriangleMesh& mesh_;
  SampleLattice lattice_;
  int rows_;
  std::vector<std::size_t> begin_;  // faces_ of each slab
  std::vector<std::int32_t> faces_;
};

struct LineCrossing {
  double y, z;
  int direction;  // +1 if the edge runs towards larger x
};

// Where the directed edge a -> b of the mesh crosses x, if it does.
inline bool cross_line(const TriangleMesh& mesh, std::int32_t a, std::int32_t b, double x,
                       LineCrossing& out) {
  const bool above_a = mesh.vertices[a].x > x, above_b = mesh.vertices[b].x > x;
  if (above_a == above_b) return false;
  const Vec3& low = mesh.vertices[std::min(a, b)];
  const Vec3& high = mesh.vertices[std::max(a, b)];
  const double t = (x - low.x) / (high.x - low.x);
  out = {low.y + t * (high.y - low.y), low.z + t * (high.z - low.z), above_b ? 1 : -1};
  return true;
}

// The two crossings of a face with the line x, the one at smaller y first; false if it has none.
inline bool cross_face(const TriangleMesh& mesh, const Face& face, double x, LineCrossing& first,
                       LineCrossing& second) {
  LineCrossing found[3];
  int n = 0;
  for (int c = 0; c < 3; ++c)
    if (cross_line(mesh, face[c], face[(c + 1) % 3], x, found[n])) ++n;
  if (n != 2) return false;
  first = found[0];
  second = found[1];
  if (second.y < first.y) std::swap(first, second);
  return true;
}

// What a face adds to the winding number of a point: the crossing of the column from below to it.
inline int winding_of_face(const TriangleMesh& mesh, const Face& face, const Vec3& p) {
  LineCrossing low, high;
  if (!cross_face(mesh, face, p.x, low, high) || p.y < low.y || p.y >= high.y) return 0;
  const double z = low.z + (p.y - low.y) / (high.y - low.y) * (high.z - low.z);
  return z <= p.z ? -low.direction : 0;
}

}  // namespace tledface
