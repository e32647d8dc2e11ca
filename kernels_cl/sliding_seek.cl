// Level 4 of sliding.cl by the items of a work-group together (sliding_queue.cl): what seek_candidates
// does, with the same parts. Cells of the box are dealt out to items, then the triangles in them, then those
// whose ball is near. What is found is a set, and its nearest are told by their ranks by distance, of equal
// ones by number: nothing depends on which item is first.
// What is branched on where a barrier follows is the same for all items of a group.

// Items of a work-group, one for each candidate; cells and triangles that it looks at in a round.
#define SLIDE_ITEMS 32
#define SEEK_EACH 2
#define SEEK_ROUND (SLIDE_ITEMS * SEEK_EACH)
// Triangles that there is room for, no fewer than are kept and a round finds; past that the nearest are
// kept and only nearer ones are taken.
#define SEEK_FOUND 128
// Places of the set of triangles that were looked at, of which a quarter stays empty, so that each is
// soon found.
#define SEEK_SET 256

// Local memory of a work-group.
typedef struct {
  // Of borders of one or two zones.
  real ahead[2 * ZONE_MOST_BORDERS], behind[2 * ZONE_MOST_BORDERS];
  real farther[ZONE_MOST_BORDERS], nears[ZONE_MOST_BORDERS];
  // Of candidates: what is nearest in each, then how far it lets a ball reach.
  real square[SLIDE_ITEMS], hold[SLIDE_ITEMS], at[3 * SLIDE_ITEMS];
  int number[SLIDE_ITEMS], feature[SLIDE_ITEMS];
  // Of a search.
  int total[SLIDE_ITEMS], entries[SEEK_ROUND], close[SEEK_ROUND], n_close;
  int set[SEEK_SET], found[SEEK_FOUND], n_found, kept[SLIDE_MOST + 1];
  real found_distance[SEEK_FOUND], kept_distance[SLIDE_MOST + 1];
} Together;

INLINE void local_barrier() { barrier(CLK_LOCAL_MEM_FENCE); }
INLINE void full_barrier() { barrier(CLK_LOCAL_MEM_FENCE | CLK_GLOBAL_MEM_FENCE); }

// A cell of a ring, of 24 ring^2 + 2 (of 1 where the ring is 0), less the cell in the middle: first the two
// ends in z, then the sides of each layer between, on the way round.
typedef struct { int x, y, z; } Cell;
INLINE Cell cell_of_ring(int ring, int k) {
  const int side = 2 * ring + 1, end = side * side, round = 8 * ring;
  Cell cell;
  if (k < 2 * end) {
    cell.z = k < end ? -ring : ring;
    cell.y = k % end / side - ring;
    cell.x = k % side - ring;
    return cell;
  }
  const int m = (k - 2 * end) % round, along = m % (2 * ring) - ring, way = m / (2 * ring);
  cell.z = (k - 2 * end) / round - ring + 1;
  cell.x = way == 0 ? along : way == 1 ? ring : way == 2 ? -along : -ring;
  cell.y = way == 0 ? -ring : way == 1 ? along : way == 2 ? ring : -along;
  return cell;
}

// Squared distance of the surface's nearest triangle, as nearest_in_grid.
INLINE real nearest_together(const SlideSurfaces* s, int surface, Point p, __local Together* w,
                             int item) {
  Rings rings;
  rings_about(s, surface, p, &rings);
  real best = R(-1.0);
  int face = -1, ring = 0, seeks;
  do {
    const int n_cells = ring ? 24 * ring * ring + 2 : 1;
    for (int k = item; k < n_cells; k += SLIDE_ITEMS) {
      const Cell cell = cell_of_ring(ring, k);
      const int x = rings.x + cell.x, y = rings.y + cell.y, z = rings.z + cell.z;
      if (x >= 0 && x < rings.grid[0] && y >= 0 && y < rings.grid[1] && z >= 0 && z < rings.grid[2])
        look_into_cell(s, &rings, x, y, z, p, &best, &face);
    }
    local_barrier();
    w->square[item] = best;
    w->number[item] = face;
    local_barrier();
    for (int k = 0; k < SLIDE_ITEMS; ++k)
      if (w->number[k] >= 0 && is_nearer(w->square[k], w->number[k], best, face)) {
        best = w->square[k];
        face = w->number[k];
      }
    seeks = (face < 0 || !is_within_ring(&rings, ring, best)) && ring + 1 < rings.longest;
    ++ring;
  } while (seeks);
  return best;
}

// Puts a triangle into the set; whether it is new there.
INLINE int is_new(volatile __local int* set, int t) {
  unsigned at = (unsigned)t * 2654435769u >> 16;
  for (;; ++at) {
    const int was = atomic_cmpxchg(set + at % SEEK_SET, 0, t + 1);
    if (was == 0 || was == t + 1) return was == 0;
  }
}

// Ranks of those found: the nearest, and one more, go to w->kept in their order.
INLINE void rank_found(__local Together* w, int n_found, int item) {
  for (int k = item; k < n_found; k += SLIDE_ITEMS) {
    const real distance = w->found_distance[k];
    const int t = w->found[k];
    int rank = 0;
#pragma unroll 4
    for (int i = 0; i < n_found; ++i)
      rank += is_nearer(w->found_distance[i], w->found[i], distance, t);
    if (rank <= SLIDE_MOST) {
      w->kept[rank] = t;
      w->kept_distance[rank] = distance;
    }
  }
}
// From where on triangles are missing where some were ranked behind those that are kept.
INLINE real limit_of(const __local Together* w, int n_found, real limit) {
  return n_found > SLIDE_MOST ? w->kept_distance[SLIDE_MOST] : limit;
}
INLINE int most_kept(int n_found) { return n_found < SLIDE_MOST ? n_found : SLIDE_MOST; }

// As seek_within; those that are found are ranked in w->kept.
INLINE int seek_within_together(const SlideSurfaces* s, int surface, Point p, real* within,
                                __local Together* w, int item) {
  __global const int* grid = s->grids + surface * GRID_INTS;
  __global const real* low = s->grid_reals + surface * GRID_REALS;
  for (int k = item; k < SEEK_SET; k += SLIDE_ITEMS) w->set[k] = 0;
  if (item == 0) w->n_close = w->n_found = 0;
  local_barrier();
  real limit = *within;
  const CellBox box = cells_about(grid, low, p, limit);
  const int nx = box.x1 - box.x0 + 1, ny = box.y1 - box.y0 + 1, nz = box.z1 - box.z0 + 1,
            n_cells = nx * ny * nz;
  int in_set = 0, base = 0;
  do {
    int begin[SEEK_EACH], n_in[SEEK_EACH], mine = 0;
    for (int j = 0; j < SEEK_EACH; ++j) {
      const int k = base + j * SLIDE_ITEMS + item, is = k < n_cells;
      const int x = box.x0 + k % nx, y = box.y0 + k / nx % ny, z = box.z0 + k / nx / ny;
      const int cell = is ? grid[3] + (z * grid[1] + y) * grid[0] + x : grid[3];
      begin[j] = s->cell_begin[cell];
      n_in[j] = s->cell_begin[cell + 1] - begin[j];
      if (!is || cell_is_beyond(low, x, y, z, p, limit)) n_in[j] = 0;
      mine += n_in[j];
    }
    local_barrier();
    w->total[item] = mine;
    local_barrier();
    int offset = 0, total = 0;
    for (int k = 0; k < SLIDE_ITEMS; ++k) {
      offset += k < item ? w->total[k] : 0;
      total += w->total[k];
    }
    // In the cells' order, a round's worth at a time.
    int from = 0;
    do {
      const int to = total < from + SEEK_ROUND ? total : from + SEEK_ROUND;
      int at = offset;
#pragma unroll
      for (int j = 0; j < SEEK_EACH; ++j) {
        const int end = at + n_in[j] < to ? at + n_in[j] : to;
        for (int e = at > from ? at : from; e < end; ++e) w->entries[e - from] = begin[j] + e - at;
        at += n_in[j];
      }
      local_barrier();
      // What the items read is on its way together, for each and among them.
      int t[SEEK_EACH];
      Point centre[SEEK_EACH];
      real radius[SEEK_EACH];
      for (int j = 0; j < SEEK_EACH; ++j) {
        const int e = j * SLIDE_ITEMS + item;
        t[j] = from + e < to ? s->cell_triangles[w->entries[e]] : -1;
      }
      for (int j = 0; j < SEEK_EACH; ++j) {
        __global const real* ball =
            s->triangles + (long)(t[j] < 0 ? 0 : t[j]) * TRIANGLE_REALS + TRIANGLE_BALL;
        centre[j] = point_at(ball);
        radius[j] = ball[3];
      }
      for (int j = 0; j < SEEK_EACH; ++j)
        if (t[j] >= 0 && !ball_is_beyond(centre[j], radius[j], p, limit) && is_new(w->set, t[j]))
          w->close[atomic_inc(&w->n_close)] = t[j];
      local_barrier();
      const int n_close = w->n_close;
      for (int k = item; k < n_close; k += SLIDE_ITEMS) {
        const int near = w->close[k];
        const real distance = square_root_of(
            closest_on_triangle(s->triangles + (long)near * TRIANGLE_REALS, p).square);
        if (distance < limit) {
          const int at = atomic_inc(&w->n_found);
          w->found[at] = near;
          w->found_distance[at] = distance;
        }
      }
      local_barrier();
      // Where another round might find no room the nearest alone go on.
      const int n_found = w->n_found;
      in_set += n_close;
      const int is_full = n_found + SEEK_ROUND > SEEK_FOUND || 4 * (in_set + SEEK_ROUND) > 3 * SEEK_SET;
      if (is_full) {
        rank_found(w, n_found, item);
        for (int k = item; k < SEEK_SET; k += SLIDE_ITEMS) w->set[k] = 0;
      }
      local_barrier();
      if (item == 0) w->n_close = 0;
      if (is_full) {
        limit = limit_of(w, n_found, limit);
        in_set = most_kept(n_found);
        if (item == 0) w->n_found = in_set;
        if (item < in_set) {
          w->found[item] = w->kept[item];
          w->found_distance[item] = w->kept_distance[item];
          is_new(w->set, w->kept[item]);
        }
      }
      local_barrier();
      from += SEEK_ROUND;
    } while (from < total);
    base += SEEK_ROUND;
  } while (base < n_cells);
  const int n_found = w->n_found;
  rank_found(w, n_found, item);
  local_barrier();
  *within = limit_of(w, n_found, limit);
  return most_kept(n_found);
}

// Level 4, as seek_candidates.
INLINE void seek_together(const SlideSurfaces* s, int surface, Point p, real keep,
                          __global int* candidates, __global real* reals, __local Together* w,
                          int item) {
  const real edge = s->grid_reals[surface * GRID_REALS + 3];
  real limit = far_enough(keep * keep, edge);
  int count = 0;
  for (int found = 0, again = 0; !found; ++again) {
    if (again) {
      const int n_known = candidates[0];
      if (item < n_known)
        w->square[item] =
            closest_on_triangle(s->triangles + (long)candidates[1 + item] * TRIANGLE_REALS, p)
                .square;
      local_barrier();
      real first = R(-1.0);
      for (int k = 0; k < n_known; ++k)
        first = first < R(0.0) || w->square[k] < first ? w->square[k] : first;
      if (first < R(0.0)) first = nearest_together(s, surface, p, w, item);
      limit = far_enough(first, edge);
    }
    count = seek_within_together(s, surface, p, &limit, w, item);
    found = count > 0 || again;
  }
  full_barrier();  // all have read what is written here
  if (item < count) {
    candidates[1 + item] = w->kept[item];
    reals[4 + item] = w->kept_distance[item];
  }
  if (item == 0) {
    candidates[0] = count;
    write_hold(reals, p, count, w->kept_distance[0], limit);
  }
  full_barrier();
}
