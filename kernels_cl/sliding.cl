// Nodes that slide on triangle surfaces at a fixed distance, without friction (Warburton & Maddock
// 2014, section 5.4): after each step a node is put back along the normal of its closest point. Three
// levels, so that nearly every node costs a few multiplications:
//
// 1. While the closest point is on one face the surface is that face's plane, while it is on one edge
//    or corner the surface is that line or point. The region of places for which that is known to hold
//    is a ball about the place where level 2 was last run, less what lies past some borders. It is
//    looked at only when the node's ways since add up to what was left to its nearest side.
// 2. Past it, the exact closest point (face, edge or vertex; side by angle-weighted pseudonormals,
//    Baerentzen & Aanaes 2005) among the node's own candidates: with d_1 the nearest distance and d_k
//    the nearest of a triangle that is none, no other can be closest within (d_k - d_1)/2.
// 3. Past that, the candidates are sought again in a uniform grid of the triangles.
//
// What a node gets does not depend on when levels 2 and 3 were last run for it, so results repeat bit
// for bit and a restart goes on with the same bits. All positions are relative to a point amid the
// nodes. Arrays: sliding_layout.cl.

// Places farther than this from the middle of the nodes are lost, m.
#define LOST R(1e3)
// Share of a coordinate that rounding is worth, twice over.
#if TLED_DOUBLE
#define FLAT R(4e-16)
#else
#define FLAT R(2e-7)
#endif

typedef struct { real x, y, z; } Point;

typedef struct {
  Point at;
  real square;  // squared distance
  int feature;  // 0 face, 1 ... 3 edge, 4 ... 6 vertex
} Nearest;

typedef struct {
  __global const real* triangles;
  __global const int* grids;
  __global const real* grid_reals;
  __global const int* cell_begin;
  __global const int* cell_triangles;
} SlideSurfaces;

INLINE Point point_at(__global const real* p) {
  Point a = {p[0], p[1], p[2]};
  return a;
}
INLINE Point minus(Point a, Point b) {
  Point c = {a.x - b.x, a.y - b.y, a.z - b.z};
  return c;
}
INLINE Point plus_scaled(Point a, real s, Point b) {
  Point c = {a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
  return c;
}
INLINE real inner(Point a, Point b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Closest point of a triangle (Ericson, Real-Time Collision Detection, 2005, 5.1.5).
INLINE Nearest closest_on_triangle(__global const real* triangle, Point p) {
  const Point a = point_at(triangle), b = point_at(triangle + 3), c = point_at(triangle + 6);
  const Point ab = minus(b, a), ac = minus(c, a), ap = minus(p, a);
  const Point bp = minus(p, b), cp = minus(p, c);
  const real d1 = inner(ab, ap), d2 = inner(ac, ap), d3 = inner(ab, bp), d4 = inner(ac, bp),
             d5 = inner(ab, cp), d6 = inner(ac, cp);
  const real vc = d1 * d4 - d3 * d2, vb = d5 * d2 - d1 * d6, va = d3 * d6 - d5 * d4;
  Nearest n;
  if (d1 <= R(0.0) && d2 <= R(0.0)) {
    n.feature = 4;
    n.at = a;
  } else if (d3 >= R(0.0) && d4 <= d3) {
    n.feature = 5;
    n.at = b;
  } else if (d6 >= R(0.0) && d5 <= d6) {
    n.feature = 6;
    n.at = c;
  } else if (vc <= R(0.0) && d1 >= R(0.0) && d3 <= R(0.0)) {
    n.feature = 1;
    n.at = plus_scaled(a, d1 / (d1 - d3), ab);
  } else if (va <= R(0.0) && d4 >= d3 && d5 >= d6) {
    n.feature = 2;
    n.at = plus_scaled(b, (d4 - d3) / ((d4 - d3) + (d5 - d6)), minus(c, b));
  } else if (vb <= R(0.0) && d2 >= R(0.0) && d6 <= R(0.0)) {
    n.feature = 3;
    n.at = plus_scaled(a, d2 / (d2 - d6), ac);
  } else {
    n.feature = 0;
    const real sum = R(1.0) / (va + vb + vc);
    n.at = plus_scaled(plus_scaled(a, vb * sum, ab), vc * sum, ac);
  }
  const Point off = minus(p, n.at);
  n.square = inner(off, off);
  return n;
}

INLINE real square_root_of(real x) {
#if TLED_OPENCL
  return sqrt(x);
#else
  return sizeof(real) == 4 ? __builtin_sqrtf(x) : __builtin_sqrt(x);
#endif
}

// A place that is no number is in cell 0: whoever looks at the state says what happened.
INLINE int clamped_cell(real x, real low, real edge, int count) {
  const real cell = (x - low) / edge;
  return cell > R(0.0) ? (cell < (real)count ? (int)cell : count - 1) : 0;
}

// Distance of a place from the grid along one axis; 0 within.
INLINE real beyond(real x, real low, real edge, int count) {
  const real high = low + edge * (real)count;
  return x < low ? low - x : x > high ? x - high : R(0.0);
}

// Distance, along one axis, from a place in the grid to the nearest side of its cell.
INLINE real within_cell(real x, real low, real edge, int cell, int count) {
  real q = x < low ? low : x;
  const real high = low + edge * (real)count;
  q = q > high ? high : q;
  const real below = q - (low + edge * (real)cell), above = edge - below;
  const real least = below < above ? below : above;
  return least > R(0.0) ? least : R(0.0);
}

// Squared distance of the surface's nearest triangle, by rings of cells about the place; its number
// goes to *face, of equally near ones the lowest.
OUT_OF_LINE real nearest_in_grid(const SlideSurfaces* s, int surface, Point p, int* face) {
  __global const int* grid = s->grids + surface * GRID_INTS;
  __global const real* low = s->grid_reals + surface * GRID_REALS;
  const real edge = low[3];
  const int nx = grid[0], ny = grid[1], nz = grid[2];
  const int cx = clamped_cell(p.x, low[0], edge, nx), cy = clamped_cell(p.y, low[1], edge, ny),
            cz = clamped_cell(p.z, low[2], edge, nz);
  real margin = within_cell(p.x, low[0], edge, cx, nx);
  const real my = within_cell(p.y, low[1], edge, cy, ny),
             mz = within_cell(p.z, low[2], edge, cz, nz);
  margin = my < margin ? my : margin;
  margin = mz < margin ? mz : margin;
  const real bx = beyond(p.x, low[0], edge, nx), by = beyond(p.y, low[1], edge, ny),
             bz = beyond(p.z, low[2], edge, nz);
  const real gap = bx * bx + by * by + bz * bz;
  int longest = nx > ny ? nx : ny;
  longest = nz > longest ? nz : longest;
  real best = R(-1.0);
  *face = -1;
  for (int ring = 0; ring < longest; ++ring) {
    for (int z = cz - ring; z <= cz + ring; ++z) {
      if (z < 0 || z >= nz) continue;
      for (int y = cy - ring; y <= cy + ring; ++y) {
        if (y < 0 || y >= ny) continue;
        const int on_side = z == cz - ring || z == cz + ring || y == cy - ring || y == cy + ring;
        // Inside the ring's shell only its two ends along x are new.
        const int stride = on_side || ring == 0 ? 1 : 2 * ring;
        for (int x = cx - ring; x <= cx + ring; x += stride) {
          if (x < 0 || x >= nx) continue;
          const int cell = grid[3] + (z * ny + y) * nx + x;
          for (int i = s->cell_begin[cell]; i < s->cell_begin[cell + 1]; ++i) {
            const int t = s->cell_triangles[i];
            const real square = closest_on_triangle(s->triangles + (long)t * TRIANGLE_REALS, p).square;
            if (*face < 0 || square < best || (square == best && t < *face)) {
              best = square;
              *face = t;
            }
          }
        }
      }
    }
    // Cells beyond this ring are at least so far from the grid's place nearest to p, and the way from
    // there to them and the way to p are at a right angle or more.
    const real far = margin + edge * (real)ring;
    if (*face >= 0 && best <= far * far + gap) break;
  }
  return best;
}

// Whether no place of a cell is nearer than `limit` to p. Cells at the grid's rim reach no farther:
// triangles do not either.
INLINE int cell_is_beyond(__global const real* low, int x, int y, int z, Point p, real limit) {
  const real edge = low[3], middle = R(0.5) * edge;
  real dx = p.x - (low[0] + edge * (real)x + middle), dy = p.y - (low[1] + edge * (real)y + middle),
       dz = p.z - (low[2] + edge * (real)z + middle);
  // A little more than half, for rounding.
  const real reach = R(0.5001) * edge;
  dx = (dx < R(0.0) ? -dx : dx) - reach;
  dy = (dy < R(0.0) ? -dy : dy) - reach;
  dz = (dz < R(0.0) ? -dz : dz) - reach;
  real square = dx > R(0.0) ? dx * dx : R(0.0);
  square += dy > R(0.0) ? dy * dy : R(0.0);
  square += dz > R(0.0) ? dz * dz : R(0.0);
  return square > limit * limit;
}

// Level 3: the nearest triangles by their distances, as many as there is room for, and how far they
// hold. Those of the last time, if any, tell how far to look.
OUT_OF_LINE void seek_candidates(const SlideSurfaces* s, int surface, Point p,
                                 __global int* candidates, __global real* reals) {
  __global const int* grid = s->grids + surface * GRID_INTS;
  __global const real* low = s->grid_reals + surface * GRID_REALS;
  const real edge = low[3];
  real first = R(-1.0);
  for (int k = 0; k < candidates[0]; ++k) {
    const real square =
        closest_on_triangle(s->triangles + (long)candidates[1 + k] * TRIANGLE_REALS, p).square;
    first = first < R(0.0) || square < first ? square : first;
  }
  int nearest;
  if (first < R(0.0)) first = nearest_in_grid(s, surface, p, &nearest);
  int ids[SLIDE_MOST];
  real kept[SLIDE_MOST];
  int count = 0;
  // Triangles from here on may be missing.
  real limit = R(1.0001) * square_root_of(first) + edge;
  const real reach = limit;
  const int x0 = clamped_cell(p.x - reach, low[0], edge, grid[0]),
            x1 = clamped_cell(p.x + reach, low[0], edge, grid[0]),
            y0 = clamped_cell(p.y - reach, low[1], edge, grid[1]),
            y1 = clamped_cell(p.y + reach, low[1], edge, grid[1]),
            z0 = clamped_cell(p.z - reach, low[2], edge, grid[2]),
            z1 = clamped_cell(p.z + reach, low[2], edge, grid[2]);
  for (int z = z0; z <= z1; ++z)
    for (int y = y0; y <= y1; ++y)
      for (int x = x0; x <= x1; ++x) {
        const int cell = grid[3] + (z * grid[1] + y) * grid[0] + x;
        const int begin = s->cell_begin[cell], end = s->cell_begin[cell + 1];
        if (begin == end || cell_is_beyond(low, x, y, z, p, limit)) continue;
        for (int i = begin; i < end; ++i) {
          const int t = s->cell_triangles[i];
          __global const real* triangle = s->triangles + (long)t * TRIANGLE_REALS;
          const Point off = minus(p, point_at(triangle + TRIANGLE_BALL));
          const real far = limit + triangle[TRIANGLE_BALL + 3];
          if (inner(off, off) >= far * far) continue;
          int known = 0;
          for (int k = 0; k < count; ++k) known |= ids[k] == t;
          if (known) continue;
          const real distance = square_root_of(closest_on_triangle(triangle, p).square);
          if (distance >= limit) continue;
          // The farthest goes where there is no room.
          if (count == SLIDE_MOST) {
            if (distance >= kept[count - 1]) {
              limit = distance;
              continue;
            }
            limit = kept[count - 1];
          } else {
            ++count;
          }
          int at = count - 1;
          for (; at > 0 && kept[at - 1] > distance; --at) {
            kept[at] = kept[at - 1];
            ids[at] = ids[at - 1];
          }
          kept[at] = distance;
          ids[at] = t;
        }
      }
  candidates[0] = count;
  for (int k = 0; k < count; ++k) {
    candidates[1 + k] = ids[k];
    reals[4 + k] = kept[k];
  }
  reals[0] = p.x;
  reals[1] = p.y;
  reals[2] = p.z;
  // A little less than half, for rounding.
  reals[3] = count ? R(0.49) * (limit - kept[0]) : R(0.0);
}

// Where a closest point is known to stay on its face, edge or corner: within `ball` of the node, but
// not past borders that are `within` of it in the directions `outward`, the nearest first.
typedef struct {
  real ball;
  int n_borders;
  real within[REGION_MOST_BORDERS];
  Point outward[REGION_MOST_BORDERS];
} Region;

INLINE void hold_within(Region* region, real distance) {
  region->ball = distance < region->ball ? distance : region->ball;
}
// A border: the nearest are kept, the others shrink the ball.
INLINE void hold_before(Region* region, real distance, Point outward) {
  if (distance >= region->ball) return;
  int at = region->n_borders;
  if (at == REGION_MOST_BORDERS) {
    --at;
    if (distance >= region->within[at]) {
      hold_within(region, distance);
      return;
    }
    hold_within(region, region->within[at]);
  } else {
    ++region->n_borders;
  }
  for (; at > 0 && region->within[at - 1] > distance; --at) {
    region->within[at] = region->within[at - 1];
    region->outward[at] = region->outward[at - 1];
  }
  region->within[at] = distance;
  region->outward[at] = outward;
}

INLINE Point times(real s, Point a) {
  Point b = {s * a.x, s * a.y, s * a.z};
  return b;
}
INLINE Point across(Point a, Point b) {
  Point c = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  return c;
}
INLINE Point unit_of(Point a) { return times(R(1.0) / square_root_of(inner(a, a)), a); }
INLINE int same(Point a, Point b) { return a.x == b.x && a.y == b.y && a.z == b.z; }

INLINE int is_corner(__global const real* triangle, Point v) {
  return same(point_at(triangle), v) || same(point_at(triangle + 3), v) ||
         same(point_at(triangle + 6), v);
}

// Height of a triangle's highest corner over a plane, of those that are none of the plane's triangle:
// the ones both have are on it, whatever the rounding.
INLINE real height_over(__global const real* other, __global const real* triangle, Point n,
                        Point on) {
  real most = R(-1.0);
  for (int corner = 0; corner < 3; ++corner) {
    const Point v = point_at(other + 3 * corner);
    if (is_corner(triangle, v)) continue;
    const real height = inner(n, minus(v, on));
    most = height > most ? height : most;
  }
  return most;
}

// The region of a face, without the other triangles: the prism over it.
INLINE void hold_over_face(Region* region, __global const real* triangle, Point p) {
  const Point n = point_at(triangle + TRIANGLE_NORMAL);
  for (int side = 0; side < 3; ++side) {
    const Point a = point_at(triangle + 3 * side),
                along = minus(point_at(triangle + 3 * ((side + 1) % 3)), a);
    // Inwards where the corners run counter-clockwise about n; an axis order may have turned that.
    Point inwards = unit_of(across(n, along));
    if (inner(inwards, minus(point_at(triangle + 3 * ((side + 2) % 3)), a)) < R(0.0))
      inwards = times(R(-1.0), inwards);
    hold_before(region, inner(inwards, minus(p, a)), times(R(-1.0), inwards));
  }
}

// Whether a triangle has both ends of an edge; if so, the direction in its plane from the edge to its
// third corner.
INLINE int beside_edge(__global const real* triangle, Point a, Point b, Point along,
                       Point* inwards) {
  if (!is_corner(triangle, a) || !is_corner(triangle, b)) return 0;
  for (int corner = 0; corner < 3; ++corner) {
    const Point v = point_at(triangle + 3 * corner);
    if (same(v, a) || same(v, b)) continue;
    const Point off = minus(v, a);
    *inwards = unit_of(plus_scaled(off, -inner(off, along), along));
    return 1;
  }
  return 0;
}

// Levels 2 and 3 for one node at displacement u: its surface and how far that holds. rows: of its
// lane. The result says whether it is on an edge or corner.
OUT_OF_LINE int find_surface(const SlideSurfaces* s, Point u, int surface, int free,
                             __global real* rows, __global real* region_rows,
                             __global int* candidates, __global real* reals) {
  const Point X = {region_rows[REGION_PLACE * TLED_LANES], region_rows[(REGION_PLACE + 1) * TLED_LANES],
                   region_rows[(REGION_PLACE + 2) * TLED_LANES]};
  const Point p = {X.x + u.x, X.y + u.y, X.z + u.z};
  // A state that has run away is for the watch to report, not to be sought for.
  if (!(inner(p, p) < LOST * LOST)) return 0;
  Point off = minus(p, point_at(reals));
  real moved = square_root_of(inner(off, off));
  if (!(moved < reals[3])) {
    seek_candidates(s, surface, p, candidates, reals);
    moved = R(0.0);
  }
  const int count = candidates[0];
  // A candidate is at least as far as it was, less the way since.
  real known[SLIDE_MOST];
  int n_known = 0, face = -1;
  Nearest best;
  best.at = p;
  best.square = R(0.0);
  best.feature = 0;
  real distance = R(0.0);
  for (; n_known < count; ++n_known) {
    // A little farther, for rounding.
    if (face >= 0 && R(0.9999) * reals[4 + n_known] - moved > distance) break;
    const int t = candidates[1 + n_known];
    const Nearest n = closest_on_triangle(s->triangles + (long)t * TRIANGLE_REALS, p);
    known[n_known] = square_root_of(n.square);
    if (face < 0 || n.square < best.square || (n.square == best.square && t < face)) {
      best = n;
      face = t;
      distance = known[n_known];
    }
  }
  if (face < 0) return 0;  // no number is near anything
  __global const real* triangle = s->triangles + (long)face * TRIANGLE_REALS;
  const Point away = minus(p, best.at);
  const Point first = point_at(triangle), normal = point_at(triangle + TRIANGLE_NORMAL);
  const real size = square_root_of(inner(minus(point_at(triangle + 3), first),
                                         minus(point_at(triangle + 3), first)));
  // What rounding may lift a corner of a flat neighbour off the plane.
  const real flat = FLAT * square_root_of(inner(p, p)) + FLAT * size;
  Region region;
  region.ball = reals[3] - moved;
  region.n_borders = 0;
  Point n = normal, on = first, axis = {R(0.0), R(0.0), R(0.0)}, far_end = first;
  real side, round = R(0.0);
  if (best.feature == 0) {
    side = inner(away, normal) < R(0.0) ? R(-1.0) : R(1.0);
    hold_over_face(&region, triangle, p);
  } else {
    const Point pseudo =
        point_at(triangle + (best.feature < 4 ? TRIANGLE_EDGES + 3 * (best.feature - 1)
                                              : TRIANGLE_VERTICES + 3 * (best.feature - 4)));
    side = inner(away, pseudo) < R(0.0) ? R(-1.0) : R(1.0);
    // Within rounding of the surface the way to it has no direction: the pseudonormal has.
    const int has_way = distance > R(1e-6) * size;
    n = has_way ? times(side / distance, away) : pseudo;
    on = best.at;
    // Held components, and no way: a plane for this step alone.
    if (free == 7 && has_way) {
      round = side;
      hold_within(&region, distance);
      if (best.feature < 4) {
        on = point_at(triangle + 3 * (best.feature - 1));
        far_end = point_at(triangle + 3 * (best.feature % 3));
        // The same end whichever of its two triangles the edge was found by.
        if (on.x > far_end.x || (on.x == far_end.x && (on.y > far_end.y || (on.y == far_end.y &&
                                                                           on.z > far_end.z)))) {
          const Point swap = on;
          on = far_end;
          far_end = swap;
        }
        const Point along = minus(far_end, on);
        axis = unit_of(along);
        const real at = inner(axis, minus(p, on));
        hold_before(&region, at, times(R(-1.0), axis));
        hold_before(&region, square_root_of(inner(along, along)) - at, axis);
      } else {
        on = point_at(triangle + 3 * (best.feature - 4));
      }
    } else {
      region.ball = R(0.0);
    }
  }
  // The triangles beside an edge: what lies behind both is never nearer than the edge.
  __global const real* beside[2] = {triangle, triangle};
  int n_beside = 0;
  if (round != R(0.0))
    for (int k = 0; k < count; ++k) {
      __global const real* other = s->triangles + (long)candidates[1 + k] * TRIANGLE_REALS;
      Point inwards;
      if (best.feature < 4) {
        if (!beside_edge(other, on, far_end, axis, &inwards)) continue;
        hold_before(&region, -inner(inwards, minus(p, on)), inwards);
        if (n_beside < 2) beside[n_beside] = other;
        ++n_beside;
      } else if (is_corner(other, on)) {
        for (int corner = 0; corner < 3; ++corner) {
          const Point v = point_at(other + 3 * corner);
          if (same(v, on)) continue;
          const Point along = unit_of(minus(v, on));
          hold_before(&region, -inner(along, minus(p, on)), along);
        }
      }
    }
  for (int k = 0; k < count && region.ball > R(0.0); ++k) {
    const int t = candidates[1 + k];
    __global const real* other = s->triangles + (long)t * TRIANGLE_REALS;
    if (best.feature == 0 ? t == face : best.feature < 4 ? n_beside && (other == beside[0] || other == beside[1])
                                                         : is_corner(other, on))
      continue;
    const real least = R(0.9999) * reals[4 + k] - moved;
    if (k >= n_known && R(0.49) * (least - distance) >= region.ball) break;
    const real there = k < n_known ? known[k] : square_root_of(closest_on_triangle(other, p).square);
    real hold = R(0.49) * (there - distance);
    if (hold >= region.ball) continue;
    if (best.feature == 0) {
      const Point up = times(side, normal);
      const Point facing = times(side, point_at(other + TRIANGLE_NORMAL)), tilt = minus(facing, up);
      const real slope = square_root_of(inner(tilt, tilt));
      // How much higher the node is over the other's plane than over this one.
      real lead = inner(facing, minus(p, point_at(other))) - inner(up, minus(p, first));
      real turn = R(1.0);
      if (height_over(other, triangle, up, first) <= flat) {
        // Behind this one's plane: never nearer than that, as long as the node stays before it, or
        // is less deep behind this one's plane than behind the other's.
        hold = distance > hold ? distance : hold;
        lead = -lead;
        turn = R(-1.0);
      }
      if (slope > R(1e-3) && lead > hold * slope) {
        hold_before(&region, lead / slope, times(-turn / slope, tilt));
        continue;
      }
    } else if (best.feature < 4 && n_beside == 2 && round > R(0.0)) {
      const Point n0 = point_at(beside[0] + TRIANGLE_NORMAL),
                  n1 = point_at(beside[1] + TRIANGLE_NORMAL);
      if (height_over(other, beside[0], n0, on) <= flat && height_over(other, beside[1], n1, on) <= flat)
        hold = distance > hold ? distance : hold;
    }
    hold_within(&region, hold);
  }
  // A little less, for rounding.
  real radius = R(0.98) * region.ball - flat;
  radius = radius > R(0.0) ? radius : R(0.0);
  // The way back in the components that may move.
  Point along = {free & 1 ? n.x : R(0.0), free & 2 ? n.y : R(0.0), free & 4 ? n.z : R(0.0)};
  const real share = inner(along, n);
  along = times(free == 7 ? R(1.0) : share > R(0.01) ? R(1.0) / share : R(0.0), along);
  if (round != R(0.0)) n = axis;
  const Point to = minus(on, X);
  const real keep = region_rows[REGION_DISTANCE * TLED_LANES];
  real slack = radius;
  for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
    __global real* border = region_rows + (REGION_BORDERS + 4 * k) * TLED_LANES;
    const int is = k < region.n_borders;
    const real within = is ? R(0.98) * region.within[k] - flat : R(1.0);
    const Point out = is ? region.outward[k] : times(R(0.0), normal);
    border[0] = out.x;
    border[TLED_LANES] = out.y;
    border[2 * TLED_LANES] = out.z;
    border[3 * TLED_LANES] = inner(out, u) + within;
    slack = within < slack ? within : slack;
  }
  const real values[SLIDE_ROWS] = {slack, n.x, n.y, n.z,
                                  round != R(0.0) ? keep : keep + inner(n, to),
                                  round, to.x, to.y, to.z};
  for (int k = 0; k < SLIDE_ROWS; ++k) rows[k * TLED_LANES] = values[k];
  const real region_values[REGION_BORDERS] = {along.x, along.y, along.z, u.x, u.y, u.z, radius};
  for (int k = 0; k < REGION_BORDERS; ++k) region_rows[k * TLED_LANES] = region_values[k];
  return round != R(0.0);
}

// Displacement of a node at X as seen from a surface in a pose, and a vector turned out of the pose.
INLINE Point seen_from(__global const real* pose, Point X, Point u) {
  const Point p = {X.x + u.x - pose[9], X.y + u.y - pose[10], X.z + u.z - pose[11]};
  const Point seen = {pose[0] * p.x + pose[3] * p.y + pose[6] * p.z - X.x,
                      pose[1] * p.x + pose[4] * p.y + pose[7] * p.z - X.y,
                      pose[2] * p.x + pose[5] * p.y + pose[8] * p.z - X.z};
  return seen;
}
typedef struct { realv x, y, z; } Points;
INLINE Points lanes_at(__global const real* u, __global const int* dofs) {
  Points p;
  p.x = gather_lanes(u, dofs);
  p.y = gather_lanes(u + TLED_LANES, dofs);
  p.z = gather_lanes(u + 2 * TLED_LANES, dofs);
  return p;
}
INLINE Points lanes_of(__global const real* rows) {
  Points p;
  p.x = load_lanes(rows);
  p.y = load_lanes(rows + TLED_LANES);
  p.z = load_lanes(rows + 2 * TLED_LANES);
  return p;
}
INLINE Points lanes_seen_from(__global const real* pose, Points X, Points u) {
  const realv x = X.x + u.x - pose[9], y = X.y + u.y - pose[10], z = X.z + u.z - pose[11];
  Points seen;
  seen.x = pose[0] * x + pose[3] * y + pose[6] * z - X.x;
  seen.y = pose[1] * x + pose[4] * y + pose[7] * z - X.y;
  seen.z = pose[2] * x + pose[5] * y + pose[8] * z - X.z;
  return seen;
}
INLINE Points lanes_turned(__global const real* pose, Points a) {
  Points b;
  b.x = pose[0] * a.x + pose[1] * a.y + pose[2] * a.z;
  b.y = pose[3] * a.x + pose[4] * a.y + pose[5] * a.z;
  b.z = pose[6] * a.x + pose[7] * a.y + pose[8] * a.z;
  return b;
}
INLINE realv lanes_inner(Points a, Points b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// How far rubbing shortens the way along the surface in a step, as a share of it. off: the way back to
// the distance, along the normal.
INLINE realv rubbed_share(realv coefficient, realv off, realv way) {
  const realv share = coefficient * absolute(off) / (way + R(1e-30));
  return share < R(1.0) ? share : broadcast(R(1.0));
}

// A row of nodes and what it slides on; `first` to `last`: the lanes of the work-item.
typedef struct {
  __global real* rows;
  __global real* regions;
  __global int* ints;
  __global int* candidates;
  __global real* candidate_reals;
  __global const real* pose;  // of a surface that moves
  int moves, first, last;
} SlideRow;

// Where the nodes of a row are as seen from their surface.
INLINE Points lanes_seen(const SlideRow* row, Points u) {
  if (!row->moves) return u;
  return lanes_seen_from(row->pose, lanes_of(row->regions + row->first + REGION_PLACE * TLED_LANES), u);
}

// Distance to the nearest side of the regions of a row's nodes, seen from their surface; not above 0
// outside.
INLINE realv left_in_regions(const SlideRow* row, Points u) {
  __global const real* lanes = row->regions + row->first;
  const Points anchor = lanes_of(lanes + REGION_ANCHOR * TLED_LANES);
  const Points way = {u.x - anchor.x, u.y - anchor.y, u.z - anchor.z};
  realv left =
      load_lanes(lanes + REGION_RADIUS * TLED_LANES) - square_root(lanes_inner(way, way));
  for (int k = 0; k < REGION_MOST_BORDERS; ++k) {
    __global const real* border = lanes + (REGION_BORDERS + 4 * k) * TLED_LANES;
    const realv to = load_lanes(border + 3 * TLED_LANES) - lanes_inner(lanes_of(border), u);
    left = to < left ? to : left;
  }
  return left;
}

// The rest of level 1, and levels 2 and 3: afterwards the row's surfaces are those of the places
// `seen` of u. way: at least what its nodes went since they were last here.
INLINE void find_surfaces(const SlideRow* row, const SlideSurfaces* s, Points seen, realv way,
                          __global const real* u) {
  __global real* lanes = row->rows + row->first;
  const realv slack = load_lanes(lanes + SLIDE_SLACK * TLED_LANES) - way;
  store_lanes(slack, lanes + SLIDE_SLACK * TLED_LANES);
  if (all_below(-slack, broadcast(R(0.0)))) return;
  const realv left = left_in_regions(row, seen);
  store_lanes(left, lanes + SLIDE_SLACK * TLED_LANES);
  if (all_below(-left, broadcast(R(0.0)))) return;
  int round = 0;
  for (int lane = row->first; lane < row->last; ++lane) {
    const int surface = row->ints[SLIDE_SURFACE * TLED_LANES + lane];
    if (surface < 0) continue;
    __global real* mine = row->rows + lane;
    __global real* region = row->regions + lane;
    if (mine[SLIDE_SLACK * TLED_LANES] > R(0.0)) {
      round |= mine[SLIDE_ROUND * TLED_LANES] != R(0.0);
      continue;
    }
    const int dof = row->ints[lane];
    Point v = {u[dof], u[dof + TLED_LANES], u[dof + 2 * TLED_LANES]};
    if (row->moves) {
      const Point X = {region[REGION_PLACE * TLED_LANES], region[(REGION_PLACE + 1) * TLED_LANES],
                       region[(REGION_PLACE + 2) * TLED_LANES]};
      v = seen_from(row->pose, X, v);
    }
    // Held components are looked after by whoever turns the way back, where the surface may turn.
    const int free = row->moves ? 7 : row->ints[SLIDE_FREE * TLED_LANES + lane];
    round |= find_surface(s, v, surface, free, mine, region, row->candidates + lane * SLIDE_CANDIDATES,
                          row->candidate_reals + lane * SLIDE_CANDIDATE_REALS);
  }
  __global int* shape = row->ints + SLIDE_SHAPE * TLED_LANES + row->first;
  *shape = (*shape & ~1) | round;
}

// How far off their distance nodes are, which way is back, and the unit normal.
typedef struct {
  realv off;
  Points back, normal;
} WayBack;

INLINE WayBack way_back(const SlideRow* row, Points seen) {
  __global const real* lanes = row->rows + row->first;
  const int shape = row->ints[SLIDE_SHAPE * TLED_LANES + row->first];
  const realv target = load_lanes(lanes + SLIDE_TARGET * TLED_LANES);
  // The normal, or the edge's direction.
  const Points n = lanes_of(lanes + SLIDE_NORMAL * TLED_LANES);
  WayBack way;
  way.off = target - lanes_inner(n, seen);
  way.normal = way.back = n;
  if (shape & 2) way.back = lanes_of(row->regions + row->first + REGION_ALONG * TLED_LANES);
  if (shape & 1) {
    const realv round = load_lanes(lanes + SLIDE_ROUND * TLED_LANES);
    const Points on = lanes_of(lanes + SLIDE_ON * TLED_LANES);
    Points q = {seen.x - on.x, seen.y - on.y, seen.z - on.z};
    const realv along = lanes_inner(n, q);
    q.x -= along * n.x;
    q.y -= along * n.y;
    q.z -= along * n.z;
    const realv length = square_root(lanes_inner(q, q));
    const realv scale = round / length;
    way.off = round != R(0.0) ? target - round * length : way.off;
    way.normal.x = round != R(0.0) ? scale * q.x : n.x;
    way.normal.y = round != R(0.0) ? scale * q.y : n.y;
    way.normal.z = round != R(0.0) ? scale * q.z : n.z;
    way.back.x = round != R(0.0) ? way.normal.x : way.back.x;
    way.back.y = round != R(0.0) ? way.normal.y : way.back.y;
    way.back.z = round != R(0.0) ? way.normal.z : way.back.z;
  }
  return way;
}

// A node that may leave is only ever pushed to its side of the surface.
INLINE realv released(realv off, __global const real* region, __global const real* laws) {
  const realv pushed = load_lanes(region + REGION_DISTANCE * TLED_LANES) < R(0.0) ? -off : off;
  const realv held =
      load_lanes(laws + SLIDE_RELEASE * TLED_LANES) > R(0.5) ? pushed : absolute(off);
  return held < R(0.0) ? broadcast(R(0.0)) : off;
}

// Work-item: a row of TLED_LANES sliding nodes from `first_row` on, or one node where rows are no
// vectors. Moves them to their distance in u_next. pose_column: of the step table; -1: surfaces that
// stand still. has_laws: slide_laws is there. task, bits: 1 the nodes may be anywhere since the last
// launch; 2 the ways back are to be kept, for reactions.
__kernel void slide_nodes(__global real* restrict u_next, __global const real* restrict u_now,
                          __global real* restrict slide_rows,
                          __global real* restrict slide_regions, __global int* restrict slide_ints,
                          __global const real* restrict slide_laws,
                          __global int* restrict candidates,
                          __global real* restrict candidate_reals,
                          __global const real* restrict triangles, __global const int* restrict grids,
                          __global const real* restrict grid_reals,
                          __global const int* restrict cell_begin,
                          __global const int* restrict cell_triangles,
                          __global const real* restrict step_table, int n_items, int first_row,
                          int has_laws, int pose_column, int step_reals, int step_index,
                          int task) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
#if TLED_VECTOR_ROWS
  const int place = first_row + item, first = 0, last = TLED_LANES;
#else
  const int place = first_row + item / TLED_LANES, first = item % TLED_LANES, last = first + 1;
#endif
  __global const real* step = step_table + (long)step_index * step_reals;
  const long node = (long)place * TLED_LANES;
  const SlideRow row = {slide_rows + node * SLIDE_ROWS,
                        slide_regions + node * REGION_ROWS,
                        slide_ints + node * SLIDE_INTS,
                        candidates + node * SLIDE_CANDIDATES,
                        candidate_reals + node * SLIDE_CANDIDATE_REALS,
                        step + (pose_column < 0 ? 0 : pose_column + POSE_REALS),
                        pose_column >= 0,
                        first,
                        last};
  const SlideSurfaces surfaces = {triangles, grids, grid_reals, cell_begin, cell_triangles};
  __global real* lanes = row.rows + first;
  __global real* region = row.regions + first;
  __global const int* dofs = row.ints + first;
  Points u = lanes_at(u_next, dofs);
  Points seen = lanes_seen(&row, u);
  // The way in this step as seen from the surface.
  Points step_way = lanes_at(u_now, dofs);
  if (row.moves)
    step_way = lanes_seen_from(row.pose - POSE_REALS, lanes_of(region + REGION_PLACE * TLED_LANES),
                               step_way);
  step_way.x = seen.x - step_way.x;
  step_way.y = seen.y - step_way.y;
  step_way.z = seen.z - step_way.z;
  // A little more, for rounding.
  const realv gone = task & 1 ? broadcast(R(1e30))
                              : R(1.001) * square_root(lanes_inner(step_way, step_way));
  find_surfaces(&row, &surfaces, seen, gone, u_next);
  WayBack way = way_back(&row, seen);
  if (has_laws) {
    __global const real* laws = slide_laws + node * SLIDE_LAWS + first;
    const Points may = lanes_of(laws + SLIDE_MAY * TLED_LANES);
    const realv coefficient = load_lanes(laws + SLIDE_FRICTION * TLED_LANES);
    if (!all_below(coefficient, broadcast(R(1e-30)))) {
      // Of the way in this step the part along the surface.
      Points rubbed = step_way;
      const realv steep = lanes_inner(rubbed, way.normal);
      rubbed.x -= steep * way.normal.x;
      rubbed.y -= steep * way.normal.y;
      rubbed.z -= steep * way.normal.z;
      const realv length = square_root(lanes_inner(rubbed, rubbed));
      const realv share = rubbed_share(coefficient, released(way.off, region, laws), length);
      store_lanes(load_lanes(region + REGION_LOSS * TLED_LANES) +
                      share * length * length * (R(1.0) - share) / step[STEP_FORCE],
                  region + REGION_LOSS * TLED_LANES);
      if (row.moves) rubbed = lanes_turned(row.pose, rubbed);
      u.x -= share * may.x * rubbed.x;
      u.y -= share * may.y * rubbed.y;
      u.z -= share * may.z * rubbed.z;
      scatter_lanes(u.x, u_next, dofs);
      scatter_lanes(u.y, u_next + TLED_LANES, dofs);
      scatter_lanes(u.z, u_next + 2 * TLED_LANES, dofs);
      seen = lanes_seen(&row, u);
      find_surfaces(&row, &surfaces, seen, R(1.001) * share * length, u_next);
      way = way_back(&row, seen);
    }
    way.off = released(way.off, region, laws);
    if (row.moves) {
      const Points to = lanes_turned(row.pose, way.normal);
      const Points free = {may.x * to.x, may.y * to.y, may.z * to.z};
      const realv part = lanes_inner(free, to);
      const realv scale = part > R(0.01) ? R(1.0) / part : broadcast(R(0.0));
      way.back.x = scale * free.x;
      way.back.y = scale * free.y;
      way.back.z = scale * free.z;
    }
  }
  scatter_lanes(u.x + way.off * way.back.x, u_next, dofs);
  scatter_lanes(u.y + way.off * way.back.y, u_next + TLED_LANES, dofs);
  scatter_lanes(u.z + way.off * way.back.z, u_next + 2 * TLED_LANES, dofs);
  store_lanes(load_lanes(lanes + SLIDE_SLACK * TLED_LANES) - R(1.001) * absolute(way.off) *
                  square_root(lanes_inner(way.back, way.back)),
              lanes + SLIDE_SLACK * TLED_LANES);
  if (task & 2) {
    store_lanes(way.back.x, region + REGION_ALONG * TLED_LANES);
    store_lanes(way.back.y, region + (REGION_ALONG + 1) * TLED_LANES);
    store_lanes(way.back.z, region + (REGION_ALONG + 2) * TLED_LANES);
  }
}

// Work-item: a place (3 reals). Its nearest triangle and squared distance: what the grid finds.
__kernel void grid_nearest(__global const real* restrict places, __global int* restrict faces,
                           __global real* restrict squares, __global const real* restrict triangles,
                           __global const int* restrict grids,
                           __global const real* restrict grid_reals,
                           __global const int* restrict cell_begin,
                           __global const int* restrict cell_triangles, int n, int surface) {
  const int i = (int)get_global_id(0);
  if (i >= n) return;
  const SlideSurfaces s = {triangles, grids, grid_reals, cell_begin, cell_triangles};
  int face;
  squares[i] = nearest_in_grid(&s, surface, point_at(places + 3 * i), &face);
  faces[i] = face;
}
