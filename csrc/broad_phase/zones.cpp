#include "broad_phase/zones.hpp"

#include <algorithm>
#include <cmath>

#include "broad_phase/corner_cone.hpp"
#include "broad_phase/sliding_layout.hpp"
#include "broad_phase/zone_space.hpp"
#include "core/threads.hpp"

namespace tledface {
namespace {

// Of each zone while zones are made, border by border; the kernels' are packed in groups.
constexpr std::size_t kZoneReals = ZONE_BORDERS + ZONE_BORDER_REALS * ZONE_MOST_BORDERS;

// Of an edge sharper than this cosine of half the angle between its normals there is no zone, nor
// of a corner whose cone is as wide.
constexpr double kSharp = 0.2;
// Part of the largest radius of the triangles beside it within which an edge or a corner is too
// near for a direction from it.
constexpr double kTooNear = 1e-5;
// Triangles, edges or corners that a thread takes at a time: enough for what it keeps of all
// triangles (Found).
constexpr std::size_t kChunk = 512;
// Numbers below it, and half of one more, are floats.
constexpr std::int32_t kMostNumber = 1 << 23;

bool is_behind(const ZoneTriangle& other, const Vec3& up, const Vec3& on, double rounding) {
  for (const Vec3& v : other.corner)
    if (dot(up, v - on) > rounding) return false;
  return true;
}

struct Edge {
  std::int32_t triangle, other;
  int side, other_side;
};

// A corner and the triangles about it: 3 triangle + number of the corner in it.
struct Corner {
  Vec3 at;
  std::vector<std::int32_t> of;
  CornerCone cone;
  std::vector<std::int32_t> sides;  // 3 triangle + side, along each of the cone's bounds
  std::vector<Vec3> ways;           // directions of these
};

// Which triangles a search has found already: they are in several cells.
class Found {
 public:
  explicit Found(std::size_t n_triangles) : n_triangles_(n_triangles) {}
  void begin() {
    if (when_.empty()) when_.assign(n_triangles_, 0);
    ++now_;
  }
  bool is_new(std::int32_t triangle) {
    const bool found = when_[triangle] == now_;
    when_[triangle] = now_;
    return !found;
  }

 private:
  std::size_t n_triangles_;
  std::vector<std::int32_t> when_;
  std::int32_t now_ = 0;
};

// The triangles of one surface, seen from one side.
class SideZones {
 public:
  SideZones(const SurfaceGrids& surfaces, std::size_t surface, bool behind, double reach,
            const std::vector<std::uint8_t>& wanted, double rounding, Zones& zones)
      : surfaces_(surfaces),
        grid_(surfaces.grids.data() + surface * GRID_INTS),
        low_(surfaces.grid_reals.data() + surface * GRID_REALS),
        first_(surfaces.first_triangle[surface]),
        n_(surfaces.first_triangle[surface + 1] - first_),
        behind_(behind),
        sign_(behind ? -1.0 : 1.0),
        reach_(reach),
        zones_(zones) {
    double extent = 0;
    for (std::int32_t t = 0; t < n_; ++t) {
      triangles_.push_back(
          zone_triangle(surfaces.triangles.data() + std::size_t(first_ + t) * TRIANGLE_REALS));
      extent = std::max(extent, norm(triangles_.back().middle));
    }
    rounding_ = rounding * (extent + reach);
    number_.assign(n_, -1);
    for (std::int32_t t = 0; t < n_; ++t) {
      if (!wanted.empty() && !wanted[t]) continue;
      number_[t] = static_cast<std::int32_t>(wanted_.size());
      wanted_.push_back(t);
    }
  }

  void make() {
    base_ = static_cast<std::int32_t>(zones_.reals.size() / kZoneReals);
    neighbour_.assign(3 * std::size_t(n_), -1);
    const std::size_t n_faces = wanted_.size();
    std::vector<ZoneSpace> faces(n_faces);
    parallel_for_chunks(n_faces, kChunk, [&](std::size_t begin, std::size_t end) {
      Found found(n_);
      for (std::size_t i = begin; i < end; ++i) faces[i] = face(wanted_[i], found);
    });
    std::vector<Edge> edges;
    std::vector<std::int32_t> zone_of_side(3 * std::size_t(n_), -1);
    for (const std::int32_t t : wanted_)
      for (int k = 0; k < 3; ++k) {
        const std::int32_t other = neighbour_[3 * t + k];
        if (other < t || !is_convex(t, k)) continue;
        const int back = shared_side(triangles_[other], triangles_[t]);
        if (neighbour_[3 * other + back] != t) continue;
        zone_of_side[3 * t + k] = zone_of_side[3 * other + back] =
            base_ + static_cast<std::int32_t>(n_faces + edges.size());
        edges.push_back({t, other, k, back});
      }
    const std::vector<Corner> corners = corners_with_room();
    std::vector<std::int32_t> zone_of_corner(3 * std::size_t(n_), -1);
    for (std::size_t i = 0; i < corners.size(); ++i)
      for (const std::int32_t corner : corners[i].of)
        zone_of_corner[corner] = base_ + static_cast<std::int32_t>(n_faces + edges.size() + i);
    const std::size_t n_lines = n_faces + edges.size(), count = n_lines + corners.size();
    zones_.reals.resize((base_ + count) * kZoneReals, 0.0);
    parallel_for_chunks(count, kChunk, [&](std::size_t begin, std::size_t end) {
      Found found(n_);
      for (std::size_t z = begin; z < end; ++z) {
        ZoneSpace space = z < n_faces   ? std::move(faces[z])
                          : z < n_lines ? edge(edges[z - n_faces], found)
                                        : corner(corners[z - n_lines], found);
        double* reals = &zones_.reals[(base_ + z) * kZoneReals];
        const auto put = [&](int at, const Vec3& v) {
          for (int a = 0; a < 3; ++a) reals[at + a] = v[a];
        };
        // Where there is no room for what bounds it, nothing is in it.
        if (space.borders.size() > ZONE_MOST_BORDERS) space.close();
        reals[ZONE_COUNT] = static_cast<double>(space.borders.size());
        for (std::size_t k = 0; k < space.borders.size(); ++k) {
          const ZoneBorder& border = space.borders[k];
          const int at = ZONE_BORDERS + static_cast<int>(k) * ZONE_BORDER_REALS;
          put(at, border.outward);
          reals[at + 3] = border.limit;
          std::int32_t behind = border.side >= 0     ? zone_of_side[border.side]
                                : border.corner >= 0 ? zone_of_corner[border.corner]
                                                     : -1;
          if (behind < 0 && border.triangle >= 0 && number_[border.triangle] >= 0)
            behind = base_ + number_[border.triangle];
          reals[at + 4] = behind;
        }
        if (z < n_faces) {
          put(ZONE_ON, triangles_[wanted_[z]].corner[0]);
          put(ZONE_DIRECTION, triangles_[wanted_[z]].normal);
          continue;
        }
        reals[ZONE_ROUND] = behind_ ? -1 : 1;
        if (z >= n_lines) {
          put(ZONE_ON, corners[z - n_lines].at);
          continue;
        }
        const Edge& e = edges[z - n_faces];
        Vec3 from = triangles_[e.triangle].corner[e.side],
             to = triangles_[e.triangle].corner[(e.side + 1) % 3];
        if (to < from) std::swap(from, to);
        put(ZONE_ON, from);
        put(ZONE_DIRECTION, unit(to - from));
      }
    });
    for (const std::int32_t t : wanted_) {
      std::int32_t* of = &zones_.of_triangle[std::size_t(first_ + t) * TRIANGLE_ZONES +
                                             (behind_ ? TRIANGLE_ZONES / 2 : 0)];
      of[0] = base_ + number_[t];
      for (int k = 0; k < 3; ++k) {
        of[1 + k] = zone_of_side[3 * t + k];
        of[4 + k] = zone_of_corner[3 * t + k];
      }
    }
  }

 private:
  Vec3 up(std::int32_t t) const { return sign_ * triangles_[t].normal; }

  // How steeply the triangle behind a side rises over this one's plane, as a sine; 0: there is
  // none.
  double rise_behind(std::int32_t t, int k) const {
    const std::int32_t other = neighbour_[3 * t + k];
    if (other < 0) return 0;
    const int back = shared_side(triangles_[other], triangles_[t]);
    return dot(up(t), inwards(triangles_[other], back));
  }
  bool is_convex(std::int32_t t, int k) const { return rise_behind(t, k) < 0; }

  // Corners of the triangles that zones are wanted of, on this side of which there are places that
  // are nearest to them; none at a rim.
  std::vector<Corner> corners_with_room() const {
    std::vector<Vec3> places;
    for (const std::int32_t t : wanted_)
      places.insert(places.end(), triangles_[t].corner, triangles_[t].corner + 3);
    std::sort(places.begin(), places.end());
    places.erase(std::unique(places.begin(), places.end()), places.end());
    std::vector<Corner> corners(places.size());
    for (std::int32_t corner = 0; corner < 3 * n_; ++corner) {
      const Vec3& at = triangles_[corner / 3].corner[corner % 3];
      const auto place = std::lower_bound(places.begin(), places.end(), at);
      if (place != places.end() && *place == at)
        corners[place - places.begin()].of.push_back(corner);
    }
    parallel_for_chunks(corners.size(), kChunk, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        corners[i].at = places[i];
        find_cone(corners[i]);
      }
    });
    corners.erase(std::remove_if(corners.begin(), corners.end(),
                                 [](const Corner& c) { return c.cone.rays.empty(); }),
                  corners.end());
    return corners;
  }

  void find_cone(Corner& corner) const {
    // Sides that begin there, by where they end: each belongs to two triangles.
    std::vector<std::pair<Vec3, std::int32_t>> sides;
    for (const std::int32_t of : corner.of) {
      const ZoneTriangle& t = triangles_[of / 3];
      const std::int32_t after = of % 3, before = (after + 2) % 3;
      sides.push_back({t.corner[(after + 1) % 3], of - of % 3 + after});
      sides.push_back({t.corner[before], of - of % 3 + before});
    }
    std::sort(sides.begin(), sides.end());
    std::vector<Vec3> ways;
    for (std::size_t k = 0; k < sides.size(); k += 2) {
      const bool is_last = k + 2 >= sides.size();
      if (is_last && k + 1 == sides.size()) return;
      if (!(sides[k].first == sides[k + 1].first)) return;
      if (!is_last && sides[k].first == sides[k + 2].first) return;
      ways.push_back(unit(sides[k].first - corner.at));
    }
    CornerCone cone = corner_cone(ways);
    if (cone.rays.empty()) return;
    // The triangles' own, which differ where vertices are not shared: all are to say this side.
    for (const std::int32_t of : corner.of) {
      const double* pseudo = surfaces_.triangles.data() +
                             std::size_t(first_ + of / 3) * TRIANGLE_REALS + TRIANGLE_VERTICES +
                             3 * (of % 3);
      if (sign_ * dot({pseudo[0], pseudo[1], pseudo[2]}, cone.middle) <= 0) return;
    }
    for (const std::size_t k : cone.bounds) {
      corner.sides.push_back(sides[2 * k].second);
      corner.ways.push_back(ways[k]);
    }
    corner.cone = std::move(cone);
  }

  // Triangles whose balls come `within` of the ball about a box, ascending.
  std::vector<std::int32_t> near(const Vec3& low, const Vec3& high, double within,
                                 Found& found) const {
    std::int64_t from[3], to[3];
    for (int a = 0; a < 3; ++a) {
      const auto index = [&](double x) {
        return std::clamp<std::int64_t>(
            static_cast<std::int64_t>(std::floor((x - low_[a]) / low_[3])), 0, grid_[a] - 1);
      };
      from[a] = index(low[a] - within);
      to[a] = index(high[a] + within);
    }
    const Vec3 middle = 0.5 * (low + high);
    const double half = 0.5 * norm(high - low) + within;
    std::vector<std::int32_t> result;
    found.begin();
    for (std::int64_t z = from[2]; z <= to[2]; ++z)
      for (std::int64_t y = from[1]; y <= to[1]; ++y)
        for (std::int64_t x = from[0]; x <= to[0]; ++x) {
          const std::size_t cell = grid_[3] + (z * grid_[1] + y) * grid_[0] + x;
          for (std::int32_t i = surfaces_.cell_begin[cell]; i < surfaces_.cell_begin[cell + 1];
               ++i) {
            const std::int32_t t = surfaces_.cell_triangles[i] - first_;
            if (found.is_new(t) &&
                norm(triangles_[t].middle - middle) <= half + triangles_[t].radius)
              result.push_back(t);
          }
        }
    std::sort(result.begin(), result.end());
    return result;
  }

  // The prism over a face, less what is nearer to others. Where the next face rises, the plane
  // between the two bounds it.
  ZoneSpace face(std::int32_t number, Found& found) {
    const ZoneTriangle& t = triangles_[number];
    const Vec3 rise = up(number);
    ZoneSpace space;
    space.on = t.corner[0];
    space.rise = rise;
    const auto others = near(min(min(t.corner[0], t.corner[1]), t.corner[2]),
                             max(max(t.corner[0], t.corner[1]), t.corner[2]), 2 * reach_, found);
    int count[3] = {0, 0, 0};
    std::int32_t* neighbour = &neighbour_[3 * std::size_t(number)];
    for (const std::int32_t other : others) {
      const int k = other == number ? -1 : shared_side(t, triangles_[other]);
      if (k >= 0) neighbour[k] = ++count[k] == 1 ? other : -1;
    }
    Vec3 in[3];
    double inset[3];  // of the side's border at the height `reach`
    for (int k = 0; k < 3; ++k) {
      in[k] = inwards(t, k);
      inset[k] = 0;
      ZoneBorder border{-1.0 * in[k], -dot(in[k], t.corner[k]), neighbour[k], 3 * number + k};
      const double sine = rise_behind(number, k);
      if (sine > kFlat) {
        const Vec3 facing = up(neighbour[k]);
        const Vec3 out = unit(rise - facing);
        inset[k] = reach_ * sine / (1 + dot(rise, facing));
        border.outward = out;
        border.limit = dot(out, t.corner[k]);
      }
      space.borders.push_back(border);
    }
    space.borders.push_back({rise, dot(rise, space.on) + reach_});
    space.borders.push_back({-1.0 * rise, reach_ - dot(rise, space.on)});
    const Vec3 middle = t.middle + reach_ * rise;
    space.samples.push_back(middle);
    for (int k = 0; k < 3; ++k) {
      const int before = (k + 2) % 3;
      const double g = dot(in[before], in[k]), whole = 1 - g * g;
      if (whole < 1e-6) return nothing();
      const Vec3 top = t.corner[k] + reach_ * rise +
                       ((inset[before] - g * inset[k]) / whole) * in[before] +
                       ((inset[k] - g * inset[before]) / whole) * in[k];
      space.vertices.push_back(t.corner[k]);
      space.vertices.push_back(top);
      space.samples.push_back(top);
    }
    space.samples.push_back(t.middle);
    for (const Vec3& v : t.corner) space.samples.push_back(v);
    for (const std::int32_t other : others) {
      if (other == number || other == neighbour[0] || other == neighbour[1] ||
          other == neighbour[2] || is_behind(triangles_[other], rise, space.on, rounding_))
        continue;
      space.keep_off(triangles_[other], other, rounding_);
    }
    return space;
  }

  // The wedge over an edge between its faces' prisms.
  ZoneSpace edge(const Edge& e, Found& found) const {
    const ZoneTriangle &t0 = triangles_[e.triangle], &t1 = triangles_[e.other];
    const Vec3 &a = t0.corner[e.side], &b = t0.corner[(e.side + 1) % 3];
    const Vec3 up0 = up(e.triangle), up1 = up(e.other), middle = unit(up0 + up1),
               along = unit(b - a), in0 = inwards(t0, e.side), in1 = inwards(t1, e.other_side);
    const double cosine = dot(middle, up0);
    if (cosine < kSharp) return nothing();
    ZoneSpace space;
    space.on = a;
    space.rise = (1 / cosine) * middle;
    space.borders = {{in0, dot(in0, a), e.triangle},
                     {in1, dot(in1, a), e.other},
                     {-1.0 * along, -dot(along, a), -1, -1, 3 * e.triangle + e.side},
                     {along, dot(along, b), -1, -1, 3 * e.triangle + (e.side + 1) % 3},
                     {middle, dot(middle, a) + reach_},
                     {-1.0 * middle, -dot(middle, a) - kTooNear * std::max(t0.radius, t1.radius)}};
    space.samples = {0.5 * (a + b) + reach_ * middle};
    for (const Vec3& end : {a, b}) {
      space.vertices.push_back(end);
      for (const Vec3& n : {up0, up1}) {
        space.vertices.push_back(end + (reach_ / cosine) * n);
        space.samples.push_back(space.vertices.back());
      }
    }
    for (const std::int32_t other : near(min(a, b), max(a, b), 2 * reach_ / cosine, found)) {
      if (other == e.triangle || other == e.other) continue;
      const ZoneTriangle& t = triangles_[other];
      if (is_behind(t, up0, a, rounding_) && is_behind(t, up1, a, rounding_)) continue;
      space.keep_off(t, other, rounding_);
    }
    return space;
  }

  // The cone over a corner between its edges' wedges.
  ZoneSpace corner(const Corner& c, Found& found) const {
    const CornerCone& cone = c.cone;
    double cosine = 1;
    for (const Vec3& ray : cone.rays) cosine = std::min(cosine, dot(ray, cone.middle));
    if (cosine < kSharp || c.ways.size() + 2 > ZONE_MOST_BORDERS) return nothing();
    ZoneSpace space;
    space.on = c.at;
    space.rise = (1 / cosine) * cone.middle;
    for (std::size_t k = 0; k < c.ways.size(); ++k)
      space.borders.push_back({c.ways[k], dot(c.ways[k], c.at), -1, c.sides[k]});
    double radius = 0;
    for (const std::int32_t of : c.of) radius = std::max(radius, triangles_[of / 3].radius);
    const double height = dot(cone.middle, c.at);
    space.borders.push_back({cone.middle, height + reach_});
    space.borders.push_back({-1.0 * cone.middle, -height - kTooNear * radius});
    space.samples = {c.at + reach_ * cone.middle};
    space.vertices = {c.at};
    for (const Vec3& ray : cone.rays) {
      space.vertices.push_back(c.at + (reach_ / dot(ray, cone.middle)) * ray);
      space.samples.push_back(space.vertices.back());
    }
    for (const std::int32_t other : near(c.at, c.at, 2 * reach_ / cosine, found)) {
      const ZoneTriangle& t = triangles_[other];
      bool is_apart = !std::count(t.corner, t.corner + 3, c.at), is_below = true;
      for (const Vec3& ray : cone.rays) is_below = is_below && is_behind(t, ray, c.at, rounding_);
      if (is_apart && !is_below) space.keep_off(t, other, rounding_);
    }
    return space;
  }

  static ZoneSpace nothing() {
    ZoneSpace space;
    space.borders.resize(ZONE_MOST_BORDERS + 1);
    return space;
  }

  const SurfaceGrids& surfaces_;
  const std::int32_t* grid_;
  const double* low_;
  std::int32_t first_, n_, base_ = 0;
  bool behind_;
  double sign_, reach_, rounding_ = 0;
  Zones& zones_;
  std::vector<ZoneTriangle> triangles_;
  std::vector<std::int32_t> neighbour_;        // behind each side; -1: none or several
  std::vector<std::int32_t> wanted_, number_;  // triangles with zones; of each its place there, -1
};

// Each zone in as many units as it has groups of borders: most have one, and what a look at a
// node waits for is their memory. Zones are then known by their first unit, as far as a float can
// name it.
static_assert((ZONE_BORDERS + ZONE_GROUP_REALS) % ZONE_UNIT == 0 &&
              ZONE_MOST_BORDERS % ZONE_GROUP == 0);
void pack(Zones& zones) {
  const std::size_t count = zones.reals.size() / kZoneReals;
  std::vector<std::int64_t> first(count + 1, 0);
  const auto n_borders = [&](std::size_t z) {
    return static_cast<int>(zones.reals[z * kZoneReals + ZONE_COUNT]);
  };
  for (std::size_t z = 0; z < count; ++z) {
    const int groups = (n_borders(z) + ZONE_GROUP - 1) / ZONE_GROUP;
    first[z + 1] =
        first[z] + (ZONE_BORDERS + groups * ZONE_GROUP_REALS + ZONE_UNIT - 1) / ZONE_UNIT;
  }
  const auto named = [&](std::int64_t z) {
    return z >= 0 && first[z] < kMostNumber ? static_cast<std::int32_t>(first[z]) : -1;
  };
  std::vector<double> packed(static_cast<std::size_t>(first[count]) * ZONE_UNIT, 0.0);
  for (std::size_t z = 0; z < count; ++z) {
    const double* from = &zones.reals[z * kZoneReals];
    double* to = &packed[static_cast<std::size_t>(first[z]) * ZONE_UNIT];
    std::copy_n(from, ZONE_BORDERS, to);
    for (int k = 0; k < n_borders(z); ++k) {
      const double* border = from + ZONE_BORDERS + k * ZONE_BORDER_REALS;
      for (int row = 0; row < 4; ++row) to[ZONE_BORDER_AT(k) + row * ZONE_GROUP] = border[row];
      const auto behind = static_cast<std::int64_t>(border[4]);
      const bool has_more = named(behind) >= 0 && n_borders(behind) > ZONE_GROUP;
      to[ZONE_BORDER_AT(k) + 4 * ZONE_GROUP] = named(behind) + (has_more ? ZONE_MORE : 0);
    }
    for (int k = n_borders(z); k % ZONE_GROUP != 0; ++k) {
      to[ZONE_BORDER_AT(k) + 3 * ZONE_GROUP] = kFarOff;
      to[ZONE_BORDER_AT(k) + 4 * ZONE_GROUP] = -1;
    }
  }
  zones.reals = std::move(packed);
  for (std::int32_t& zone : zones.of_triangle) zone = named(zone);
}

}  // namespace

Zones make_zones(const SurfaceGrids& surfaces, const std::vector<std::array<double, 2>>& reach,
                 const std::vector<std::vector<std::uint8_t>>& wanted, double rounding) {
  Zones zones;
  zones.of_triangle.assign(surfaces.triangles.size() / TRIANGLE_REALS * TRIANGLE_ZONES, -1);
  for (std::size_t surface = 0; surface < reach.size(); ++surface)
    for (const bool behind : {false, true})
      if (reach[surface][behind] > 0)
        SideZones(surfaces, surface, behind, reach[surface][behind],
                  wanted.empty() ? std::vector<std::uint8_t>() : wanted[surface], rounding, zones)
            .make();
  pack(zones);
  return zones;
}

}  // namespace tledface
