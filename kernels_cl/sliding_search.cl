// The triangles nearest to a place: one triangle's closest point, and level 4 of sliding.cl, the
// search in a uniform grid. Arrays: sliding_layout.cl.

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
  __global const real* zones;
  __global const int* triangle_zones;
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

INLINE Point times(real s, Point a) {
  Point b = {s * a.x, s * a.y, s * a.z};
  return b;
}
INLINE Point across(Point a, Point b) {
  Point c = {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
  return c;
}
INLINE real square_root_of(real x) {
#if TLED_OPENCL
  return sqrt(x);
#else
  return sizeof(real) == 4 ? __builtin_sqrtf(x) : __builtin_sqrt(x);
#endif
}

INLINE Point unit_of(Point a) { return times(R(1.0) / square_root_of(inner(a, a)), a); }

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

// Of equally near triangles the one with the lowest number; `best` counts where there is a `face`.
INLINE int is_nearer(real square, int t, real best, int face) {
  return face < 0 || square < best || (square == best && t < face);
}

// The cells about a place: its own, and rings about that.
typedef struct {
  __global const int* grid;
  int x, y, z, longest;      // its own; as many rings as reach every cell
  real edge, margin, gap;    // way to the nearest side of its own; squared way to the grid
} Rings;

INLINE void rings_about(const SlideSurfaces* s, int surface, Point p, Rings* rings) {
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
  int longest = nx > ny ? nx : ny;
  longest = nz > longest ? nz : longest;
  rings->grid = grid;
  rings->x = cx;
  rings->y = cy;
  rings->z = cz;
  rings->longest = longest;
  rings->edge = edge;
  rings->margin = margin;
  rings->gap = bx * bx + by * by + bz * bz;
}

// Whether no triangle beyond this ring is nearer. Cells there are at least so far from the grid's place
// nearest to p, and the way from there to them and the way to p are at a right angle or more.
INLINE int is_within_ring(const Rings* rings, int ring, real square) {
  const real far = rings->margin + rings->edge * (real)ring;
  return square <= far * far + rings->gap;
}

// The nearest triangle of a cell, where it is nearer than `best`.
INLINE void look_into_cell(const SlideSurfaces* s, const Rings* rings, int x, int y, int z, Point p,
                           real* best, int* face) {
  const int cell = rings->grid[3] + (z * rings->grid[1] + y) * rings->grid[0] + x;
  for (int i = s->cell_begin[cell]; i < s->cell_begin[cell + 1]; ++i) {
    const int t = s->cell_triangles[i];
    const real square = closest_on_triangle(s->triangles + (long)t * TRIANGLE_REALS, p).square;
    if (is_nearer(square, t, *best, *face)) {
      *best = square;
      *face = t;
    }
  }
}

// Squared distance of the surface's nearest triangle, by rings of cells about the place; its number
// goes to *face, of equally near ones the lowest.
OUT_OF_LINE real nearest_in_grid(const SlideSurfaces* s, int surface, Point p, int* face) {
  Rings rings;
  rings_about(s, surface, p, &rings);
  const int nx = rings.grid[0], ny = rings.grid[1], nz = rings.grid[2];
  const int cx = rings.x, cy = rings.y, cz = rings.z;
  real best = R(-1.0);
  *face = -1;
  for (int ring = 0; ring < rings.longest; ++ring) {
    for (int z = cz - ring; z <= cz + ring; ++z) {
      if (z < 0 || z >= nz) continue;
      for (int y = cy - ring; y <= cy + ring; ++y) {
        if (y < 0 || y >= ny) continue;
        const int on_side = z == cz - ring || z == cz + ring || y == cy - ring || y == cy + ring;
        // Inside the ring's shell only its two ends along x are new.
        const int stride = on_side || ring == 0 ? 1 : 2 * ring;
        for (int x = cx - ring; x <= cx + ring; x += stride)
          if (x >= 0 && x < nx) look_into_cell(s, &rings, x, y, z, p, &best, face);
      }
    }
    if (*face >= 0 && is_within_ring(&rings, ring, best)) break;
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

// From where on triangles may be missing at first, with the nearest at this squared distance. A search that
// reaches a whole edge of a cell farther takes three times as long and is needed as often: nodes that seek
// have mostly just left their zones and are soon in others.
INLINE real far_enough(real first, real edge) {
  return R(1.0001) * square_root_of(first) + R(0.5) * edge;
}

// Cells with all places within `reach` of p.
typedef struct { int x0, x1, y0, y1, z0, z1; } CellBox;
INLINE CellBox cells_about(__global const int* grid, __global const real* low, Point p, real reach) {
  const real edge = low[3];
  const CellBox box = {clamped_cell(p.x - reach, low[0], edge, grid[0]),
                       clamped_cell(p.x + reach, low[0], edge, grid[0]),
                       clamped_cell(p.y - reach, low[1], edge, grid[1]),
                       clamped_cell(p.y + reach, low[1], edge, grid[1]),
                       clamped_cell(p.z - reach, low[2], edge, grid[2]),
                       clamped_cell(p.z + reach, low[2], edge, grid[2])};
  return box;
}

// Whether the ball that holds a triangle is not within `limit` of p.
INLINE int ball_is_beyond(Point centre, real radius, Point p, real limit) {
  const Point off = minus(p, centre);
  const real far = limit + radius;
  return inner(off, off) >= far * far;
}

// How far candidates of p hold: `count` with the nearest at `first`, of those from `limit` on some missing.
INLINE void write_hold(__global real* reals, Point p, int count, real first, real limit) {
  reals[0] = p.x;
  reals[1] = p.y;
  reals[2] = p.z;
  // A little less than half, for rounding.
  reals[3] = count ? R(0.49) * (limit - first) : R(0.0);
}

// The triangles that are nearer to p than *limit, the nearest first, as many as there is room for: how many.
// *limit becomes the distance from which on some may be missing.
OUT_OF_LINE int seek_within(const SlideSurfaces* s, int surface, Point p, real* limit, int* ids,
                            real* kept) {
  __global const int* grid = s->grids + surface * GRID_INTS;
  __global const real* low = s->grid_reals + surface * GRID_REALS;
  int count = 0;
  const CellBox box = cells_about(grid, low, p, *limit);
  for (int z = box.z0; z <= box.z1; ++z)
    for (int y = box.y0; y <= box.y1; ++y)
      for (int x = box.x0; x <= box.x1; ++x) {
        const int cell = grid[3] + (z * grid[1] + y) * grid[0] + x;
        const int begin = s->cell_begin[cell], end = s->cell_begin[cell + 1];
        if (begin == end || cell_is_beyond(low, x, y, z, p, *limit)) continue;
        for (int i = begin; i < end; ++i) {
          const int t = s->cell_triangles[i];
          __global const real* triangle = s->triangles + (long)t * TRIANGLE_REALS;
          if (ball_is_beyond(point_at(triangle + TRIANGLE_BALL), triangle[TRIANGLE_BALL + 3], p,
                             *limit))
            continue;
          int known = 0;
          for (int k = 0; k < count; ++k) known |= ids[k] == t;
          if (known) continue;
          const real distance = square_root_of(closest_on_triangle(triangle, p).square);
          if (distance >= *limit) continue;
          // The farthest goes where there is no room.
          if (count == SLIDE_MOST) {
            if (distance >= kept[count - 1]) {
              *limit = distance;
              continue;
            }
            *limit = kept[count - 1];
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
  return count;
}

// Level 4: the nearest triangles by their distances, as many as there is room for, and how far they
// hold. `keep`: the node's distance, about which it nearly always is; else those of the last time, if any,
// tell how far to look.
OUT_OF_LINE void seek_candidates(const SlideSurfaces* s, int surface, Point p, real keep,
                                 __global int* candidates, __global real* reals) {
  const real edge = s->grid_reals[surface * GRID_REALS + 3];
  int ids[SLIDE_MOST];
  real kept[SLIDE_MOST];
  real limit = far_enough(keep * keep, edge);
  int count = seek_within(s, surface, p, &limit, ids, kept);
  if (count == 0) {
    real first = R(-1.0);
    for (int k = 0; k < candidates[0]; ++k) {
      const real square =
          closest_on_triangle(s->triangles + (long)candidates[1 + k] * TRIANGLE_REALS, p).square;
      first = first < R(0.0) || square < first ? square : first;
    }
    int nearest;
    if (first < R(0.0)) first = nearest_in_grid(s, surface, p, &nearest);
    limit = far_enough(first, edge);
    count = seek_within(s, surface, p, &limit, ids, kept);
  }
  candidates[0] = count;
  for (int k = 0; k < count; ++k) {
    candidates[1 + k] = ids[k];
    reals[4 + k] = kept[k];
  }
  write_hold(reals, p, count, count ? kept[0] : R(0.0), limit);
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
  const SlideSurfaces s = {triangles, grids, grid_reals, cell_begin, cell_triangles, 0, 0};
  int face;
  squares[i] = nearest_in_grid(&s, surface, point_at(places + 3 * i), &face);
  faces[i] = face;
}
