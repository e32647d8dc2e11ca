// Nodes that slide on triangle surfaces at a fixed distance, without friction (Warburton & Maddock
// 2014, section 5.4): after each step a node is put back along the normal of its closest point. Three
// levels, so that nearly every node costs a plane:
//
// 1. While the closest point is inside one triangle the surface is that triangle's plane. `SLIDE_RADIUS`
//    is how far the node may move until that may end.
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

// Level 3: the nearest triangles, as many as there is room for, and how far they hold.
OUT_OF_LINE void seek_candidates(const SlideSurfaces* s, int surface, Point p,
                                 __global int* candidates, __global real* reals) {
  __global const int* grid = s->grids + surface * GRID_INTS;
  __global const real* low = s->grid_reals + surface * GRID_REALS;
  const real edge = low[3];
  int nearest;
  const real first = square_root_of(nearest_in_grid(s, surface, p, &nearest));
  real kept[SLIDE_MOST];
  int count = 0;
  real limit = first + edge;  // triangles from here on may be missing
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
        for (int i = s->cell_begin[cell]; i < s->cell_begin[cell + 1]; ++i) {
          const int t = s->cell_triangles[i];
          const real distance = square_root_of(
              closest_on_triangle(s->triangles + (long)t * TRIANGLE_REALS, p).square);
          if (distance >= limit) continue;
          int known = 0, farthest = 0;
          for (int k = 0; k < count; ++k) {
            known |= candidates[1 + k] == t;
            farthest = kept[k] > kept[farthest] ? k : farthest;
          }
          if (known) continue;
          if (count < SLIDE_MOST) {
            kept[count] = distance;
            candidates[1 + count++] = t;
          } else if (distance < kept[farthest]) {
            limit = kept[farthest];
            kept[farthest] = distance;
            candidates[1 + farthest] = t;
          } else {
            limit = distance;
          }
        }
      }
  candidates[0] = count;
  reals[0] = p.x;
  reals[1] = p.y;
  reals[2] = p.z;
  // A little less than half, for rounding.
  reals[3] = R(0.49) * (limit - first);
}

// Distance of a point of a triangle's plane from the triangle's nearest side, m.
INLINE real within_triangle(__global const real* triangle, Point q) {
  const Point n = point_at(triangle + TRIANGLE_NORMAL);
  real least = R(1e30);
  for (int side = 0; side < 3; ++side) {
    const Point a = point_at(triangle + 3 * side), b = point_at(triangle + 3 * ((side + 1) % 3));
    const Point along = minus(b, a), off = minus(q, a);
    const Point inwards = {n.y * along.z - n.z * along.y, n.z * along.x - n.x * along.z,
                           n.x * along.y - n.y * along.x};
    const real d = inner(inwards, off) / square_root_of(inner(along, along));
    least = d < least ? d : least;
  }
  return least > R(0.0) ? least : R(0.0);
}

INLINE int is_corner(__global const real* triangle, Point v) {
  int same = 0;
  for (int corner = 0; corner < 3; ++corner)
    same |= triangle[3 * corner] == v.x && triangle[3 * corner + 1] == v.y &&
            triangle[3 * corner + 2] == v.z;
  return same;
}

// Levels 2 and 3 for one node: its plane and how far that holds. rows: of its lane.
OUT_OF_LINE void find_plane(const SlideSurfaces* s, __global const real* u_next, int dof,
                            int surface, int free, __global real* rows, __global int* candidates,
                            __global real* reals) {
  const Point u = {u_next[dof], u_next[dof + TLED_LANES], u_next[dof + 2 * TLED_LANES]};
  const Point X = {rows[SLIDE_PLACE * TLED_LANES], rows[(SLIDE_PLACE + 1) * TLED_LANES],
                   rows[(SLIDE_PLACE + 2) * TLED_LANES]};
  const Point p = {X.x + u.x, X.y + u.y, X.z + u.z};
  // A state that has run away is for the watch to report, not to be sought for.
  if (!(inner(p, p) < LOST * LOST)) return;
  Point off = minus(p, point_at(reals));
  real moved = square_root_of(inner(off, off));
  if (!(moved < reals[3])) {
    seek_candidates(s, surface, p, candidates, reals);
    moved = R(0.0);
  }
  const int count = candidates[0];
  Nearest best;
  best.at = p;
  best.square = R(0.0);
  best.feature = 0;
  int face = -1;
  for (int k = 0; k < count; ++k) {
    const int t = candidates[1 + k];
    const Nearest n = closest_on_triangle(s->triangles + (long)t * TRIANGLE_REALS, p);
    if (face < 0 || n.square < best.square || (n.square == best.square && t < face)) {
      best = n;
      face = t;
    }
  }
  if (face < 0) return;  // no number is near anything
  __global const real* triangle = s->triangles + (long)face * TRIANGLE_REALS;
  const real distance = square_root_of(best.square);
  const Point away = minus(p, best.at);
  Point n = point_at(triangle + TRIANGLE_NORMAL);
  real radius = R(0.0);
  Point on = point_at(triangle);  // a point of the plane that does not depend on p
  if (best.feature == 0) {
    const real side = inner(away, n) < R(0.0) ? R(-1.0) : R(1.0);
    radius = within_triangle(triangle, best.at);
    // What rounding may lift a corner of a flat neighbour off the plane.
    const real flat = FLAT * square_root_of(inner(on, on));
    const real left = reals[3] - moved;
    radius = left < radius ? left : radius;
    for (int k = 0; k < count; ++k) {
      const int t = candidates[1 + k];
      if (t == face) continue;
      __global const real* other = s->triangles + (long)t * TRIANGLE_REALS;
      const real there = square_root_of(closest_on_triangle(other, p).square);
      real hold = R(0.49) * (there - distance);
      // A triangle that lies wholly behind this one's plane is never nearer than the plane itself,
      // as long as the node stays on its side. Corners that both have are on it, whatever the
      // rounding.
      real most = R(-1.0);
      for (int corner = 0; corner < 3; ++corner) {
        const Point v = point_at(other + 3 * corner);
        if (is_corner(triangle, v)) continue;
        const real height = side * inner(n, minus(v, on));
        most = height > most ? height : most;
      }
      if (most <= flat && distance > hold) hold = distance;
      radius = hold < radius ? hold : radius;
    }
    radius = R(0.98) * radius;
  } else {
    const Point pseudo =
        point_at(triangle + (best.feature < 4 ? TRIANGLE_EDGES + 3 * (best.feature - 1)
                                              : TRIANGLE_VERTICES + 3 * (best.feature - 4)));
    const real side = inner(away, pseudo) < R(0.0) ? R(-1.0) : R(1.0);
    // Within rounding of the surface the way to it has no direction: the pseudonormal has.
    if (distance > R(1e-6) * square_root_of(inner(minus(point_at(triangle + 3), on),
                                                  minus(point_at(triangle + 3), on)))) {
      n.x = side * away.x / distance;
      n.y = side * away.y / distance;
      n.z = side * away.z / distance;
    } else {
      n = pseudo;
    }
    on = best.at;
  }
  // The way back in the components that may move.
  Point along = {free & 1 ? n.x : R(0.0), free & 2 ? n.y : R(0.0), free & 4 ? n.z : R(0.0)};
  const real share = inner(along, n);
  const real scale = free == 7 ? R(1.0) : share > R(0.01) ? R(1.0) / share : R(0.0);
  rows[SLIDE_ANCHOR * TLED_LANES] = u.x;
  rows[(SLIDE_ANCHOR + 1) * TLED_LANES] = u.y;
  rows[(SLIDE_ANCHOR + 2) * TLED_LANES] = u.z;
  rows[SLIDE_RADIUS * TLED_LANES] = radius * radius;
  rows[SLIDE_NORMAL * TLED_LANES] = n.x;
  rows[(SLIDE_NORMAL + 1) * TLED_LANES] = n.y;
  rows[(SLIDE_NORMAL + 2) * TLED_LANES] = n.z;
  rows[SLIDE_ALONG * TLED_LANES] = scale * along.x;
  rows[(SLIDE_ALONG + 1) * TLED_LANES] = scale * along.y;
  rows[(SLIDE_ALONG + 2) * TLED_LANES] = scale * along.z;
  rows[SLIDE_OFFSET * TLED_LANES] = inner(n, minus(on, X));
}

INLINE realv squared_way(realv x, realv y, realv z, __global const real* rows) {
  const realv dx = x - load_lanes(rows + SLIDE_ANCHOR * TLED_LANES),
              dy = y - load_lanes(rows + (SLIDE_ANCHOR + 1) * TLED_LANES),
              dz = z - load_lanes(rows + (SLIDE_ANCHOR + 2) * TLED_LANES);
  return dx * dx + dy * dy + dz * dz;
}

// Work-item: a row of TLED_LANES sliding nodes, or one where rows are no vectors. Moves them to their
// distance in u_next.
__kernel void slide_nodes(__global real* restrict u_next, __global real* restrict slide_rows,
                          __global const int* restrict slide_ints,
                          __global int* restrict candidates,
                          __global real* restrict candidate_reals,
                          __global const real* restrict triangles, __global const int* restrict grids,
                          __global const real* restrict grid_reals,
                          __global const int* restrict cell_begin,
                          __global const int* restrict cell_triangles, int n_items) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
#if TLED_VECTOR_ROWS
  const int row = item, first = 0, last = TLED_LANES;
#else
  const int row = item / TLED_LANES, first = item % TLED_LANES, last = first + 1;
#endif
  __global real* own = slide_rows + (long)row * (SLIDE_ROWS * TLED_LANES);
  __global const int* ints = slide_ints + (long)row * (SLIDE_INTS * TLED_LANES);
  __global real* rows = own + first;
  __global const int* dofs = ints + first;
  const realv x = gather_lanes(u_next, dofs), y = gather_lanes(u_next + TLED_LANES, dofs),
              z = gather_lanes(u_next + 2 * TLED_LANES, dofs);
  if (!all_below(squared_way(x, y, z, rows), load_lanes(rows + SLIDE_RADIUS * TLED_LANES))) {
    const SlideSurfaces s = {triangles, grids, grid_reals, cell_begin, cell_triangles};
    for (int lane = first; lane < last; ++lane) {
      const int surface = ints[SLIDE_SURFACE * TLED_LANES + lane];
      if (surface < 0) continue;
      const int dof = ints[lane];
      __global real* mine = own + lane;
      const real dx = u_next[dof] - mine[SLIDE_ANCHOR * TLED_LANES],
                 dy = u_next[dof + TLED_LANES] - mine[(SLIDE_ANCHOR + 1) * TLED_LANES],
                 dz = u_next[dof + 2 * TLED_LANES] - mine[(SLIDE_ANCHOR + 2) * TLED_LANES];
      if (dx * dx + dy * dy + dz * dz < mine[SLIDE_RADIUS * TLED_LANES]) continue;
      const long node = (long)row * TLED_LANES + lane;
      find_plane(&s, u_next, dof, surface, ints[SLIDE_FREE * TLED_LANES + lane], mine,
                 candidates + node * SLIDE_CANDIDATES, candidate_reals + node * 4);
    }
  }
  const realv off = load_lanes(rows + SLIDE_DISTANCE * TLED_LANES) +
                    load_lanes(rows + SLIDE_OFFSET * TLED_LANES) -
                    (load_lanes(rows + SLIDE_NORMAL * TLED_LANES) * x +
                     load_lanes(rows + (SLIDE_NORMAL + 1) * TLED_LANES) * y +
                     load_lanes(rows + (SLIDE_NORMAL + 2) * TLED_LANES) * z);
  scatter_lanes(x + off * load_lanes(rows + SLIDE_ALONG * TLED_LANES), u_next, dofs);
  scatter_lanes(y + off * load_lanes(rows + (SLIDE_ALONG + 1) * TLED_LANES), u_next + TLED_LANES, dofs);
  scatter_lanes(z + off * load_lanes(rows + (SLIDE_ALONG + 2) * TLED_LANES), u_next + 2 * TLED_LANES,
                dofs);
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
