// What fills the columns of a sample lattice: a closed surface, one closed over large holes, or
// labels of a voxel image.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "mesh/scanline.hpp"
#include "mesh/surface.hpp"

namespace tledface {

// A labelled voxel image; labels in C order, the last index fastest. The voxel of a point p is the
// nearest whole index to axes * p + offset (rows of axes: one index each).
struct LabelImage {
  std::vector<std::uint16_t> labels;
  std::array<std::int64_t, 3> size{};
  std::array<Vec3, 3> axes;  // 1/m
  Vec3 offset;
};

// A closed surface, or the voxels of an image whose label is a member; one of the two is set.
struct Volume {
  const Surface* surface = nullptr;
  const LabelImage* image = nullptr;
  std::vector<char> members;  // by label
};

// Crossings of a volume with the columns of lattice slabs: a sample is inside where the sum of the
// crossings at or below it is not zero.
class Columns {
 public:
  virtual ~Columns() = default;
  // Whether the volume may reach the slab.
  virtual bool reaches(std::int64_t slab) const = 0;
  // Safe to call from several threads with different outputs.
  virtual void scan(std::int64_t slab, SlabCrossings& out) const = 0;
};

// The volume must outlive the result.
//
// A surface with large holes has no inside of its own. The generalised winding number w of a point
// (the solid angle of its faces / 4 pi, Jacobson et al. 2013) is that of the surface closed by any
// cap less that of the cap, so it needs the whole number that the columns give and the solid angle
// of the few cap faces; a point is inside where |w| > 1/2. From outside their common box the caps
// fill no more than half of the view, and the whole number decides alone.
std::unique_ptr<Columns> make_columns(const Volume& volume, const SampleLattice& lattice,
                                      int rows_per_slab);

// Solid angle of triangles seen from p over 4 pi: a closed outward surface gives 1 inside.
double winding_of_faces(const TriangleMesh& mesh, const Vec3& p);

}  // namespace tledface
