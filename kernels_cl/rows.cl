// Fused element + node kernel for CPUs: vector rows of a block's lanes, no barrier, no atomics.
//
// One work-item owns a band of node rows in y. It walks its blocks chunk by chunk in x, row by row
// in y, and plane by plane in z:
//
//        z ^   as: forces on the shared face, from the element below
//          |   +-------+        what an element gives a node row of the next y goes into `scratch`
//        k |   | elem  |  --->  (one row a plane), what its last lane gives lane 0 of the block
//          |   +-------+        behind in x goes into `edge` (three reals a block).
//          +-----------> y
//
// The transform of the face between two elements of a column is done once and stays in registers.
// A node is finished as soon as all its elements have given their forces: it is integrated on the
// spot, u_next over u_prev, which nobody else reads. The row of elements below the band is
// computed here too (a seed row), so bands do not wait for each other. The order in which a node's
// forces are added does not depend on how rows are dealt to bands: results are the same bits for any
// number of threads.

typedef struct { Vec s, x, y, xy; } Face;

INLINE void face_component(realv lower, realv lower_next, realv upper, realv upper_next,
                                  realv* s, realv* x, realv* y, realv* xy) {
  const realv a = lower + lower_next, b = lower_next - lower;
  const realv c = upper + upper_next, d = upper_next - upper;
  *s = a + c;
  *x = b + d;
  *y = c - a;
  *xy = d - b;
}

// Modes of the four corner values that the elements of `block` have at the block's own z.
INLINE Face load_face(__global const real* u, __global const int* blocks, int block) {
  __global const int* links = blocks + (long)block * TLED_BLOCK_INTS;
  const int upper = links[BLOCK_NEXT_Y];
  __global const real* l = u + (long)block * (3 * TLED_LANES);
  __global const real* ln = u + (long)links[BLOCK_NEXT_X] * (3 * TLED_LANES);
  __global const real* h = u + (long)upper * (3 * TLED_LANES);
  __global const real* hn =
      u + (long)blocks[(long)upper * TLED_BLOCK_INTS + BLOCK_NEXT_X] * (3 * TLED_LANES);
  Face f;
  realv a = load_lanes(l), b = load_lanes(h);
  face_component(a, next_lanes(a, load_lanes(ln)), b, next_lanes(b, load_lanes(hn)), &f.s.x, &f.x.x,
                 &f.y.x, &f.xy.x);
  a = load_lanes(l + TLED_LANES);
  b = load_lanes(h + TLED_LANES);
  face_component(a, next_lanes(a, load_lanes(ln + TLED_LANES)), b,
                 next_lanes(b, load_lanes(hn + TLED_LANES)), &f.s.y, &f.x.y, &f.y.y, &f.xy.y);
  a = load_lanes(l + 2 * TLED_LANES);
  b = load_lanes(h + 2 * TLED_LANES);
  face_component(a, next_lanes(a, load_lanes(ln + 2 * TLED_LANES)), b,
                 next_lanes(b, load_lanes(hn + 2 * TLED_LANES)), &f.s.z, &f.x.z, &f.y.z, &f.xy.z);
  return f;
}

INLINE void clear(Vec* v) {
  v->x = broadcast(R(0.0));
  v->y = v->x;
  v->z = v->x;
}

INLINE void clear_face(Face* f) {
  clear(&f->s);
  clear(&f->x);
  clear(&f->y);
  clear(&f->xy);
}

INLINE Vec sum(Vec a, Vec b) {
  Vec v;
  v.x = a.x + b.x;
  v.y = a.y + b.y;
  v.z = a.z + b.z;
  return v;
}

INLINE Vec difference(Vec a, Vec b) {
  Vec v;
  v.x = a.x - b.x;
  v.y = a.y - b.y;
  v.z = a.z - b.z;
  return v;
}

// Modes of an element between the faces at its low and high z.
INLINE ElementModes element_modes(Face low, Face high) {
  const Vec x = sum(low.x, high.x), y = sum(low.y, high.y), z = difference(high.s, low.s);
  ElementModes m;
  m.linear.xx = x.x;
  m.linear.yx = x.y;
  m.linear.zx = x.z;
  m.linear.xy = y.x;
  m.linear.yy = y.y;
  m.linear.zy = y.z;
  m.linear.xz = z.x;
  m.linear.yz = z.y;
  m.linear.zz = z.z;
  m.hourglass.xy = sum(low.xy, high.xy);
  m.hourglass.yz = difference(high.y, low.y);
  m.hourglass.zx = difference(high.x, low.x);
  m.hourglass.xyz = difference(high.xy, low.xy);
  return m;
}

// Corner forces of one component from the face modes; adds them to the node row and to scratch.
// Returns the force of the block's own nodes (lane l: elements l and l - 1 of both element rows).
INLINE realv distribute(realv s, realv x, realv y, realv xy, real from_left,
                               __global real* scratch, __global real* scratch_last,
                               real* to_right) {
  const realv lower = s - y, lower_x = x - xy, upper = s + y, upper_x = x + xy;
  const realv own = lower - lower_x, next = lower + lower_x;
  const realv up = upper - upper_x, up_next = upper + upper_x;
  const realv force = own + previous_lanes(next, from_left) + load_lanes(scratch);
  *to_right = last_lane(next) + *scratch_last;
  store_lanes(up + previous_lanes(up_next, R(0.0)), scratch);
  *scratch_last = last_lane(up_next);
  return force;
}

// u_next = u + velocity (u - u_prev) - force f / m + gravity, zero increment where 1/m is 0.
INLINE void integrate(__global const real* u, __global real* u_prev,
                             __global const real* inverse_mass, __global const real* step, realv f,
                             int component) {
  const realv now = load_lanes(u), before = load_lanes(u_prev), w = load_lanes(inverse_mass);
  realv next = now + step[STEP_VELOCITY] * (now - before) - (step[STEP_FORCE] * w) * f;
  const real gravity = step[STEP_GRAVITY + component];
  if (gravity != R(0.0)) next += w > R(0.0) ? broadcast(gravity) : broadcast(R(0.0));
  store_lanes(next, u_prev);
}

INLINE void process_rows(ElementTables t, __global const real* u, __global real* out,
                         __global const int* bands, __global const int* rows,
                         __global const real* node_sets, __global real* all_scratch,
                         __global real* edge, int n_planes, const int physical,
                         const int forces_only) {
  __global const int* blocks = t.blocks;
  const int band = (int)get_global_id(0);
  __global real* scratch = all_scratch + (long)band * n_planes * (SCRATCH_ROWS * TLED_LANES);
  for (int row = bands[2 * band]; row < bands[2 * band + 1]; ++row) {
    const int begin = rows[4 * row], end = begin + rows[4 * row + 1], flags = rows[4 * row + 2];
    if (flags & ROW_CHUNK_BEGIN)
      for (int i = 0; i < n_planes * SCRATCH_ROWS; ++i)
        store_lanes(broadcast(R(0.0)), scratch + i * TLED_LANES);
    Face low, low_force;
    int low_is_valid = 0;
    clear_face(&low);
    clear_face(&low_force);
    for (int block = begin; block < end; ++block) {
      __global const int* links = blocks + (long)block * TLED_BLOCK_INTS;
      Face face_force = low_force;
      if (links[BLOCK_MATERIAL] >= 0) {
        if (!low_is_valid) low = load_face(u, blocks, block);
        const Face high = load_face(u, blocks, block + 1);
        const ElementModes m = element_modes(low, high);
        const ElementModes f = compute_element_modes(
            t, m, block, 0, !forces_only && !(flags & ROW_SEED), physical);
        Vec px, py, pz;
        px.x = f.linear.xx;
        px.y = f.linear.yx;
        px.z = f.linear.zx;
        py.x = f.linear.xy;
        py.y = f.linear.yy;
        py.z = f.linear.zy;
        pz.x = f.linear.xz;
        pz.y = f.linear.yz;
        pz.z = f.linear.zz;
        face_force.s = difference(low_force.s, pz);
        face_force.x = sum(low_force.x, difference(px, f.hourglass.zx));
        face_force.y = sum(low_force.y, difference(py, f.hourglass.yz));
        face_force.xy = sum(low_force.xy, difference(f.hourglass.xy, f.hourglass.xyz));
        low_force.s = pz;
        low_force.x = sum(px, f.hourglass.zx);
        low_force.y = sum(py, f.hourglass.yz);
        low_force.xy = sum(f.hourglass.xy, f.hourglass.xyz);
        low = high;
        low_is_valid = 1;
      } else {
        clear_face(&low_force);
        low_is_valid = 0;
      }
      __global real* plane =
          scratch + (long)links[BLOCK_PLANE] * (SCRATCH_ROWS * TLED_LANES);
      __global real* plane_last = plane + 3 * TLED_LANES;
      // A seed row's forces are dropped, and the band below may be writing this edge just now.
      __global const real* from_left = flags & ROW_SEED ? plane_last : edge + (long)block * 4;
      real right_x, right_y, right_z;
      Vec force;
      force.x = distribute(face_force.s.x, face_force.x.x, face_force.y.x, face_force.xy.x,
                           from_left[0], plane, plane_last, &right_x);
      force.y = distribute(face_force.s.y, face_force.x.y, face_force.y.y, face_force.xy.y,
                           from_left[1], plane + TLED_LANES, plane_last + 1, &right_y);
      force.z = distribute(face_force.s.z, face_force.x.z, face_force.y.z, face_force.xy.z,
                           from_left[2], plane + 2 * TLED_LANES, plane_last + 2, &right_z);
      if (!(flags & ROW_SEED)) {
        if (links[BLOCK_HAS_NEXT_X]) {
          __global real* to_right = edge + (long)links[BLOCK_NEXT_X] * 4;
          to_right[0] = right_x;
          to_right[1] = right_y;
          to_right[2] = right_z;
        }
        const long at = (long)block * (3 * TLED_LANES);
        if (forces_only) {
          store_lanes(force.x, out + at);
          store_lanes(force.y, out + at + TLED_LANES);
          store_lanes(force.z, out + at + 2 * TLED_LANES);
        } else {
          __global const real* w =
              node_sets + (long)links[BLOCK_NODE] * (TLED_NODE_ROWS * TLED_LANES);
          integrate(u + at, out + at, w, t.step, force.x, 0);
          integrate(u + at + TLED_LANES, out + at + TLED_LANES, w + TLED_LANES, t.step,
                    force.y, 1);
          integrate(u + at + 2 * TLED_LANES, out + at + 2 * TLED_LANES, w + 2 * TLED_LANES,
                    t.step, force.z, 2);
        }
      }
    }
  }
}

// One explicit step. u: displacement now; u_prev: the one before, replaced by the next.
// step_table: row `step_index` of `step_reals` reals. Work-item: a band.
#define TLED_ROWS_KERNEL(name, physical, forces_only)                                              \
  __kernel void name(                                                                              \
      __global const real* restrict u, __global real* restrict u_prev,                             \
      __global const int* restrict bands, __global const int* restrict rows,                       \
      __global const int* restrict blocks, __global const real* restrict materials,                \
      __global const real* restrict node_sets, __global const int* restrict law_entries,           \
      __global const real* restrict law_sets, __global const real* restrict history,               \
      __global real* restrict next_history, __global const int* restrict muscle_entries,           \
      __global const real* restrict muscle_sets, __global const real* restrict muscle_constants,   \
      __global const real* restrict shape, __global const real* restrict step_table,               \
      __global real* restrict scratch, __global real* restrict edge, int n_bands, int n_planes,    \
      int step_index, int step_reals) {                                                            \
    if ((int)get_global_id(0) >= n_bands) return;                                                  \
    const ElementTables t = {blocks,           materials,    law_entries,                          \
                             law_sets,         history,      next_history,                         \
                             muscle_entries,   muscle_sets,  muscle_constants,                     \
                             shape,            step_table + step_index * step_reals};              \
    process_rows(t, u, u_prev, bands, rows, node_sets, scratch, edge, n_planes, physical,          \
                 forces_only);                                                                     \
  }

TLED_ROWS_KERNEL(step_rows_physical, 1, 0)
TLED_ROWS_KERNEL(step_rows_kappa, 0, 0)
TLED_ROWS_KERNEL(force_rows_physical, 1, 1)
TLED_ROWS_KERNEL(force_rows_kappa, 0, 1)
