// Level 2 of sliding.cl, zones: the places of which a face, an edge or a corner is known to be the nearest part of
// a surface, convex and the same for all nodes (csrc/broad_phase/zones). A node in one needs no search;
// one that leaves it mostly enters the zone behind the border that it crossed. A node that passes
// through the surface within a step is put back to its side, so zones are one side's.

// Zones that are tried one behind the other before a search.
#define MOST_HOPS 4

// A distance that nothing comes near, m.
#define NO_BORDER R(1e30)

#if ZONE_GROUP % GROUP_LANES
#error "GROUP_LANES must divide ZONE_GROUP"
#endif

// Borders of a zone from one of its places on, as many as are taken together.
typedef struct { realg x, y, z, limit; } ZoneBorders;
INLINE ZoneBorders borders_at(__global const real* first) {
  const ZoneBorders b = {load_group(first), load_group(first + ZONE_GROUP),
                         load_group(first + 2 * ZONE_GROUP), load_group(first + 3 * ZONE_GROUP)};
  return b;
}
INLINE realg along_borders(ZoneBorders b, Point way) {
  return b.x * way.x + b.y * way.y + b.z * way.z;
}
// Distances from a place to borders; not above 0 past them.
INLINE realg ahead_of(ZoneBorders b, Point p) { return b.limit - along_borders(b, p); }

INLINE Point border_normal(__global const real* zone, int k) {
  __global const real* at = zone + ZONE_BORDER_AT(k);
  const Point normal = {at[0], at[ZONE_GROUP], at[2 * ZONE_GROUP]};
  return normal;
}

// A zone's number and ZONE_MORE, if it has more than one group of borders.
INLINE real zone_name(const SlideSurfaces* s, int zone) {
  const real count = s->zones[(long)zone * ZONE_UNIT + ZONE_COUNT];
  return (real)zone + (count > (real)ZONE_GROUP ? R(ZONE_MORE) : R(0.0));
}

// Whether that is the end of the way through zones.
INLINE int stays_in(__global const real* zone, int free) {
  // Held components: on an edge the plane is one for this step alone.
  return free == 7 || zone[ZONE_ROUND] == R(0.0);
}

// The zone, as ZONE_MORE, that a node is tried in first: where it was, or behind the border it was nearest
// to, if it has crossed that.
INLINE real zone_to_try(__global const real* record, Point p) {
  const int has_crossed = inner(point_at(record + RECORD_EXIT), p) >= record[RECORD_EXIT + 3];
  return record[has_crossed && record[RECORD_NEXT] >= R(0.0) ? RECORD_NEXT : RECORD_ZONE];
}

// Distance from a place to the nearest border of a zone, and its number; not above 0 outside.
INLINE real left_in_zone(__global const real* zone, Point p, int* nearest) {
  const realg to = ahead_of(borders_at(zone + ZONE_BORDERS), p);
  real left = least_of(to);
  *nearest = first_place_of(to, left);
  const int count = (int)zone[ZONE_COUNT];
  for (int k = GROUP_LANES; k < count; k += GROUP_LANES) {
    const realg others = ahead_of(borders_at(zone + ZONE_BORDER_AT(k)), p);
    const real least = least_of(others);
    if (!(least < left)) continue;
    left = least;
    *nearest = k + first_place_of(others, least);
  }
  return left;
}

// The zone of a place from the one it was in on, how far that holds and the nearest border; -1: to be
// sought.
INLINE int zone_of(const SlideSurfaces* s, int zone, Point p, int free, real* left, int* nearest) {
  for (int hop = 0, before = -1; hop <= MOST_HOPS && zone >= 0; ++hop) {
    __global const real* in = s->zones + (long)zone * ZONE_UNIT;
    *left = left_in_zone(in, p, nearest);
    if (*left > R(0.0)) return stays_in(in, free) ? zone : -1;
    const int behind = (int)in[ZONE_BORDER_AT(*nearest) + 4 * ZONE_GROUP];
    if (behind == before) return -1;  // it is in neither
    before = zone;
    zone = behind;
  }
  return -1;
}

// The most a ball may grow that moves along, away from its nearest border, as far as it grows: another
// border is `farther` than the nearest and nears by `nears` of the way.
#define MOST_GROWTH R(1e3)
INLINE realg growth_before(realg most, realg farther, realg nears) {
  // No branch: which borders count is known too late to be guessed.
  const realg growth = farther / nears;
  return farther < most * nears ? growth : most;
}

INLINE real grown(real left, real most) { return most > R(0.0) ? left + most : left; }
INLINE realg nears_along(ZoneBorders b, Point outward) {
  return group_of(R(1.0)) - along_borders(b, outward);
}

// How far a ball in a zone reaches from its middle, which is where a place `left` from the nearest border
// goes if it is moved straight off that: the largest that touches the border there. A node that moves along
// a border stays in it longer than in the ball about itself.
INLINE real ball_in_zone(__global const real* zone, Point p, int nearest, real left) {
  const Point outward = border_normal(zone, nearest);
  const realg itself = group_of((real)nearest);
  realg most = group_of(MOST_GROWTH);
  const int count = (int)zone[ZONE_COUNT];
  for (int k = 0; k < count; k += GROUP_LANES) {
    const ZoneBorders borders = borders_at(zone + ZONE_BORDER_AT(k));
    // By rounding the nearest might near by a little, and nothing would grow.
    const realg farther =
        numbers_from(k) == itself ? group_of(NO_BORDER) : ahead_of(borders, p) - left;
    most = growth_before(most, farther, nears_along(borders, outward));
  }
  return grown(left, least_of(most));
}

// What a node slides on: a plane, or round an edge or corner. n: the plane's normal, before or behind
// it as the distance to keep, or the edge's direction; on: a point of it.
typedef struct {
  Point n, on, normal;
  real round;
} SlideShape;

// row_shape: as it was (HEAD_SHAPE, SLIDE_SHAPE), of `lane`. What planes in free rows never read is left alone.
INLINE void write_shape(SlideShape shape, __global const real* record, int free, int row_shape, int lane,
                        __global real* rows, __global real* region_rows) {
  const real keep = record[RECORD_DISTANCE];
  const Point to = minus(shape.on, point_at(record + RECORD_PLACE)), n = shape.normal;
  const real values[4] = {shape.n.x, shape.n.y, shape.n.z,
                          shape.round != R(0.0) ? keep : keep + inner(n, to)};
  for (int k = 0; k < 4; ++k) rows[(SLIDE_NORMAL + k) * TLED_LANES] = values[k];
  if (row_shape & 1) {
    // The way back in the components that may move.
    Point along = {free & 1 ? n.x : R(0.0), free & 2 ? n.y : R(0.0), free & 4 ? n.z : R(0.0)};
    const real share = inner(along, n);
    along = times(free == 7 ? R(1.0) : share > R(0.01) ? R(1.0) / share : R(0.0), along);
    region_rows[REGION_ALONG * TLED_LANES] = along.x;
    region_rows[(REGION_ALONG + 1) * TLED_LANES] = along.y;
    region_rows[(REGION_ALONG + 2) * TLED_LANES] = along.z;
  }
  if (shape.round != R(0.0) || row_shape >> (lane + 1) & 1) {
    region_rows[REGION_ROUND * TLED_LANES] = shape.round;
    region_rows[REGION_ON * TLED_LANES] = to.x;
    region_rows[(REGION_ON + 1) * TLED_LANES] = to.y;
    region_rows[(REGION_ON + 2) * TLED_LANES] = to.z;
  }
}

// The surface of a zone for a node at p.
INLINE SlideShape shape_of_zone(__global const real* zone, Point p) {
  SlideShape shape;
  shape.round = zone[ZONE_ROUND];
  shape.on = point_at(zone + ZONE_ON);
  shape.n = shape.normal = point_at(zone + ZONE_DIRECTION);
  if (shape.round != R(0.0)) {
    const Point off = minus(p, shape.on);
    shape.normal = times(shape.round, unit_of(plus_scaled(off, -inner(off, shape.n), shape.n)));
  }
  return shape;
}
