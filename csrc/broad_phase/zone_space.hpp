// A zone in the making (zones.hpp): convex, shrunk until nothing else of the surface can be nearer
// in it than what it is of.
#pragma once
#include <cstdint>
#include <vector>

#include "mesh/vec3.hpp"

namespace tledface {

// Larger than any coordinate, m.
constexpr double kFarOff = 1e30;
// Planes and faces at a smaller angle than this, rad, are one.
constexpr double kFlat = 1e-7;

struct ZoneTriangle {
  Vec3 corner[3], normal, middle;
  double radius;
};
// reals: TRIANGLE_REALS.
ZoneTriangle zone_triangle(const double* reals);

// The side that two triangles share: its number in the first, -1: none.
int shared_side(const ZoneTriangle& a, const ZoneTriangle& b);

// In the plane of t, from side k to the third corner.
Vec3 inwards(const ZoneTriangle& t, int k);

// What is behind: the zone of a side's edge or of a corner (3 triangle + number in it), where it
// has one, else that of a triangle; -1: none.
struct ZoneBorder {
  Vec3 outward;
  double limit = kFarOff;
  std::int32_t triangle = -1, side = -1, corner = -1;
};

// rise: a linear bound of the distance from the zone's part, rise . (x - on), which is none less
// than that. vertices: of what its borders leave, or more; samples: places in it, the first amid
// it.
struct ZoneSpace {
  Vec3 on, rise;
  std::vector<Vec3> vertices, samples;
  std::vector<ZoneBorder> borders;

  // Keeps triangle `number` farther than the zone's own part: by nothing, or a border. rounding, m.
  void keep_off(const ZoneTriangle& other, std::int32_t number, double rounding);
  // Nothing is in it.
  void close() { borders = {{rise, -kFarOff}}; }

 private:
  // Another border, which cuts off some of the vertices: what is kept off there already needs none.
  void add(const ZoneBorder& border, double rounding);
};

}  // namespace tledface
