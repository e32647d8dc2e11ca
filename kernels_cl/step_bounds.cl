// What a look at the limit of the step asks of the device: of each element the stiffness that bounds
// the step under the displacement of now, of each node omega^2 (csrc/precompute/time_step.hpp,
// docs/explanation/solver.md), and of those the few numbers that the host decides by. Infinite: an
// inverted element.

INLINE realv endless(void) { return broadcast(R(1.0)) / broadcast(R(0.0)); }

// Twice the sum over the corners of dN/dX (x) dN/dX, 1/m^2: 1/h_d^2 of a voxel.
INLINE Symmetric voxel_spread(__global const real* shape) {
  const Axes g = voxel_gradient(shape, 0);
  const realv zero = broadcast(R(0.0));
  const Symmetric G = {broadcast(R(16.0) * g.x * g.x), broadcast(R(16.0) * g.y * g.y),
                       broadcast(R(16.0) * g.z * g.z), zero, zero, zero};
  return G;
}

INLINE Symmetric hex_spread(HexElement e) {
  const realv zero = broadcast(R(0.0)), two = broadcast(R(2.0));
  Symmetric G = {zero, zero, zero, zero, zero, zero};
  for (int corner = 0; corner < 8; ++corner) {
    const realv x = hex_row(e, HEX_GRADIENT + 3 * corner),
                y = hex_row(e, HEX_GRADIENT + 3 * corner + 1),
                z = hex_row(e, HEX_GRADIENT + 3 * corner + 2);
    G.xx += two * x * x;
    G.yy += two * y * y;
    G.zz += two * z * z;
    G.xy += two * x * y;
    G.yz += two * y * z;
    G.xz += two * x * z;
  }
  return G;
}

// v . G v
INLINE realv quadratic(Symmetric G, realv x, realv y, realv z) {
  return x * x * G.xx + y * y * G.yy + z * z * G.zz +
         R(2.0) * (x * y * G.xy + y * z * G.yz + x * z * G.xz);
}

// Growth of the bulk stiffness that bounds the step: sum_d |cof F e_d|^2 / h_d^2 over its value at
// rest (the tangent of U is U'' cof F (x) cof F), times U''(J)/U''(1) of the log form.
INLINE realv stiffness_growth(Tensor cof, realv J, Symmetric G) {
  const realv inverse_J = R(1.0) / J;
  const realv spread = quadratic(G, cof.xx, cof.xy, cof.xz) + quadratic(G, cof.yx, cof.yy, cof.yz) +
                       quadratic(G, cof.zx, cof.zy, cof.zz);
  return spread * (R(1.0) / (G.xx + G.yy + G.zz)) * (R(0.5) + R(0.5) * inverse_J * inverse_J);
}

// Ends of the four edges along x of an element: where x of u is at the low ones and at those behind
// them (this lane's), or where the rows begin that these are taken from.
INLINE void element_edges(__global const int* blocks, int block, int lane, long low_at[4],
                          long high_at[4]) {
  __global const int* links = blocks + (long)block * TLED_BLOCK_INTS;
  const int above = links[BLOCK_NEXT_Z];
  __global const int* links_above = blocks + (long)above * TLED_BLOCK_INTS;
  const int low[4] = {block, links[BLOCK_NEXT_Y], above, links_above[BLOCK_NEXT_Y]};
  const int high[4] = {links[BLOCK_NEXT_X], links[BLOCK_NEXT_XY], links_above[BLOCK_NEXT_X],
                      links_above[BLOCK_NEXT_XY]};
  for (int i = 0; i < 4; ++i) {
    low_at[i] = (long)low[i] * (3 * TLED_LANES) + lane;
#if TLED_VECTOR_ROWS
    high_at[i] = (long)high[i] * (3 * TLED_LANES);
#else
    high_at[i] = lane + 1 < TLED_LANES ? low_at[i] + 1 : (long)high[i] * (3 * TLED_LANES);
#endif
  }
}

// The x, y and z mode of one component. Differences come before sums: then those of float32 are
// exact however far the element has moved as a whole.
INLINE Vec linear_component(__global const real* u, const long low_at[4], const long high_at[4]) {
  const realv a0 = load_lanes(u + low_at[0]), a2 = load_lanes(u + low_at[2]),
              right0 = load_lanes(u + high_at[0]), right2 = load_lanes(u + high_at[2]);
#if TLED_VECTOR_ROWS
  const realv a1 = next_in_y(a0, load_lanes(u + low_at[1])),
              a3 = next_in_y(a2, load_lanes(u + low_at[3]));
  const realv b0 = next_in_x(a0, right0), b2 = next_in_x(a2, right2),
              b1 = next_in_x(a1, next_in_y(right0, load_lanes(u + high_at[1]))),
              b3 = next_in_x(a3, next_in_y(right2, load_lanes(u + high_at[3])));
#else
  const realv a1 = u[low_at[1]], a3 = u[low_at[3]];
  const realv b0 = right0, b1 = u[high_at[1]], b2 = right2, b3 = u[high_at[3]];
#endif
  Vec d;
  d.x = ((b0 - a0) + (b1 - a1)) + ((b2 - a2) + (b3 - a3));
  d.y = ((a1 - a0) + (b1 - b0)) + ((a3 - a2) + (b3 - b2));
  d.z = ((a2 - a0) + (b2 - b0)) + ((a3 - a1) + (b3 - b1));
  return d;
}

// The displacement gradient of one component in a conforming mesh, likewise by differences: those
// from the first corner, since the corners' gradients add up to 0.
INLINE Vec hex_linear_component(HexElement e, __global const real* u) {
  const realv first = gather_lanes(u, e.nodes), zero = broadcast(R(0.0));
  Vec g = {zero, zero, zero};
  for (int corner = 1; corner < 8; ++corner) {
    const realv d = gather_lanes(u, e.nodes + corner * TLED_LANES) - first;
    g.x += d * hex_row(e, HEX_GRADIENT + 3 * corner);
    g.y += d * hex_row(e, HEX_GRADIENT + 3 * corner + 1);
    g.z += d * hex_row(e, HEX_GRADIENT + 3 * corner + 2);
  }
  return g;
}

INLINE Tensor rows_of(Vec x, Vec y, Vec z) {
  const Tensor T = {x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z};
  return T;
}

// Where a look finds the muscles and what it asks with (layout.cl: LOOK_...).
typedef struct {
  __global const int* blocks;
  __global const int* muscle_entries;
  __global const real* muscle_sets;
  __global const real* muscle_constants;
  __global const real* look;
} LookTables;

typedef struct {
  realv stretch, J, inverse_norm;  // |F d|, det F, |F^-1|
  realv along, across;             // d . G d, sqrt(d . G d tr G)
} FibreLook;

// Stiffness that fibres add at a share of their stretch. P = J T(stretch) F d (x) d: along the fibre,
// across it, and through J: the symmetric part of F d (x) d times F^-T is at most
// (|F d| |F^-1| + 1)/2.
INLINE realv fibre_stiffness(__global const real* constants, real activation, FibreLook k,
                             real share) {
  const realv stretch = share * k.stretch, zero = broadcast(R(0.0));
  const realv tension = muscle_tension(constants, activation, stretch);
  realv straight = stretch * muscle_tension_slope(constants, activation, stretch);
  straight = tension + (straight > zero ? straight : zero);
  straight = straight > zero ? straight : zero;
  return k.J * (straight * k.along +
                absolute(tension) * (R(0.5) * (stretch * k.inverse_norm + R(1.0))) * k.across);
}

// Stores what bounds the elements of a row, N/m: stiffness V/2, at the worst of the stretches that
// fibres may reach, and where that is another (n_samples > 1) that of now. rest: without fibres, at
// rest; 0 where there is no element.
INLINE void store_bounds(LookTables t, int block, int lane, Tensor F, Symmetric G,
                         realv half_volume, int n_samples, __global const real* rest,
                         __global real* reached, __global real* exact) {
  const long at = (long)block * TLED_LANES + lane;
  const realv zero = broadcast(R(0.0)), one = broadcast(R(1.0)), at_rest = load_lanes(rest + at);
  const Tensor cof = cofactors(F);
  const realv J = F.xx * cof.xx + F.xy * cof.xy + F.xz * cof.xz;
  const realv growth = stiffness_growth(cof, J, G);
  realv most = at_rest * (growth > one ? growth : one), now = most;
  __global const int* links = t.blocks + (long)block * TLED_BLOCK_INTS;
  for (int entry = links[BLOCK_MUSCLE_BEGIN]; entry < links[BLOCK_MUSCLE_END]; ++entry) {
    const int muscle = t.muscle_entries[2 * entry];
    __global const real* rows =
        t.muscle_sets + (long)t.muscle_entries[2 * entry + 1] * (TLED_MUSCLE_ROWS * TLED_LANES) +
        lane;
    __global const real* constants = t.muscle_constants + muscle * TLED_MUSCLE_CONSTANTS;
    const real activation = t.look[LOOK_ACTIVATION + muscle];
    const realv x = load_lanes(rows), y = load_lanes(rows + TLED_LANES),
                z = load_lanes(rows + 2 * TLED_LANES), weight = load_lanes(rows + 3 * TLED_LANES);
    const realv vx = F.xx * x + F.xy * y + F.xz * z, vy = F.yx * x + F.yy * y + F.yz * z,
                vz = F.zx * x + F.zy * y + F.zz * z;
    FibreLook k;
    k.stretch = square_root(vx * vx + vy * vy + vz * vz);
    k.J = J;
    k.inverse_norm = square_root(squared_norm(cof)) / absolute(J);
    k.along = quadratic(G, x, y, z);
    k.across = square_root(k.along * (G.xx + G.yy + G.zz));
    realv added = zero;
    for (int i = 0; i < n_samples; ++i) {
      const realv stiffness =
          fibre_stiffness(constants, activation, k, t.look[LOOK_REACH] + i * t.look[LOOK_REACH_STEP]);
      added = stiffness > added ? stiffness : added;
    }
    // Lanes without fibres have no direction, so that what stands there need not be a number.
    const realv scale = weight * half_volume;
    most += weight > zero ? scale * added : zero;
    if (n_samples > 1) {
      added = fibre_stiffness(constants, activation, k, R(1.0));
      now += weight > zero ? scale * added : zero;
    }
  }
  // Whatever is not a number is not stable either.
  most = J > zero ? (most > zero ? most : endless()) : endless();
  store_lanes(at_rest > zero ? most : zero, reached + at);
  if (n_samples > 1) {
    now = J > zero ? (now > zero ? now : endless()) : endless();
    store_lanes(at_rest > zero ? now : zero, exact + at);
  }
}

// Work-item: a row of elements. exact is written where n_samples > 1 only.
__kernel void element_bounds(
    __global const real* restrict u, __global const real* restrict rest,
    __global real* restrict reached, __global real* restrict exact,
    __global const int* restrict blocks, __global const int* restrict muscle_entries,
    __global const real* restrict muscle_sets, __global const real* restrict muscle_constants,
    __global const real* restrict shape, __global const real* restrict look, int n_blocks,
    int n_samples) {
  const int row = (int)get_global_id(0);
  if (row >= ROWS_OF_BLOCKS(n_blocks)) return;
  const int block = ROW_BLOCK(row), lane = ROW_LANE(row);
  if (blocks[(long)block * TLED_BLOCK_INTS + BLOCK_MATERIAL] < 0) return;
  const LookTables t = {blocks, muscle_entries, muscle_sets, muscle_constants, look};
  long low_at[4], high_at[4];
  element_edges(blocks, block, lane, low_at, high_at);
  const Tensor linear = rows_of(linear_component(u, low_at, high_at),
                                linear_component(u + TLED_LANES, low_at, high_at),
                                linear_component(u + 2 * TLED_LANES, low_at, high_at));
  const realv half_volume = broadcast(R(0.5) * shape[SHAPE_FORCE] / shape[SHAPE_GRADIENT]);
  store_bounds(t, block, lane, deformation_gradient(linear, voxel_gradient(shape, 0)),
               voxel_spread(shape), half_volume, n_samples, rest, reached, exact);
}

// The same of a conforming mesh.
__kernel void hex_bounds(
    __global const real* restrict u, __global const real* restrict rest,
    __global real* restrict reached, __global real* restrict exact,
    __global const int* restrict blocks, __global const int* restrict muscle_entries,
    __global const real* restrict muscle_sets, __global const real* restrict muscle_constants,
    __global const int* restrict hex_nodes, __global const real* restrict hex_rows,
    __global const real* restrict look, int n_blocks, int n_samples) {
  const int row = (int)get_global_id(0);
  if (row >= ROWS_OF_BLOCKS(n_blocks)) return;
  const int block = ROW_BLOCK(row), lane = ROW_LANE(row);
  if (blocks[(long)block * TLED_BLOCK_INTS + BLOCK_MATERIAL] < 0) return;
  const LookTables t = {blocks, muscle_entries, muscle_sets, muscle_constants, look};
  const HexElement e = hex_element(hex_nodes, hex_rows, block, lane);
  const Tensor linear =
      rows_of(hex_linear_component(e, u), hex_linear_component(e, u + TLED_LANES),
              hex_linear_component(e, u + 2 * TLED_LANES));
  store_bounds(t, block, lane, plus_identity(linear), hex_spread(e),
               R(0.5) * hex_row(e, HEX_VOLUME), n_samples, rest, reached, exact);
}

// Sum over the elements of a row of nodes, in the same order always.
INLINE realv gather_bounds(__global const real* elements, __global const int* blocks, int block,
                           int lane) {
  const int before_y = blocks[(long)block * TLED_BLOCK_INTS + BLOCK_PREV_Y];
  const int rows[4] = {block, before_y, blocks[(long)block * TLED_BLOCK_INTS + BLOCK_PREV_Z],
                       blocks[(long)before_y * TLED_BLOCK_INTS + BLOCK_PREV_Z]};
  realv sum = broadcast(R(0.0));
#if TLED_VECTOR_ROWS
  realv own[4], left[4];
  for (int i = 0; i < 4; ++i) {
    own[i] = load_lanes(elements + (long)rows[i] * TLED_LANES);
    left[i] = load_lanes(
        elements + (long)blocks[(long)rows[i] * TLED_BLOCK_INTS + BLOCK_PREV_X] * TLED_LANES);
    if (i & 1) {  // those one before in y of the plane
      own[i] = previous_in_y(own[i - 1], own[i]);
      left[i] = previous_in_y(left[i - 1], left[i]);
    }
    sum += own[i] + previous_in_x(own[i], left[i]);
  }
#else
  for (int i = 0; i < 4; ++i) {
    __global const real* own = elements + (long)rows[i] * TLED_LANES;
    __global const real* before =
        elements + (long)blocks[(long)rows[i] * TLED_BLOCK_INTS + BLOCK_PREV_X] * TLED_LANES +
        (TLED_LANES - 1);
    sum += own[lane] + (lane > 0 ? own[lane - 1] : *before);
  }
#endif
  return sum;
}

// Work-item: a row of nodes. squares: omega^2 of each, 1/s^2; 0 where all components are held.
__kernel void node_squares(__global const real* restrict elements, __global real* restrict squares,
                           __global const int* restrict blocks,
                           __global const real* restrict node_sets, int n_blocks) {
  const int row = (int)get_global_id(0);
  if (row >= ROWS_OF_BLOCKS(n_blocks)) return;
  const int block = ROW_BLOCK(row), lane = ROW_LANE(row);
  __global const real* w = node_sets + (long)blocks[(long)block * TLED_BLOCK_INTS + BLOCK_NODE] *
                                           (TLED_NODE_ROWS * TLED_LANES) + lane;
  const realv x = load_lanes(w), y = load_lanes(w + TLED_LANES), z = load_lanes(w + 2 * TLED_LANES),
              zero = broadcast(R(0.0));
  const realv of_two = x > y ? x : y, inverse_mass = of_two > z ? of_two : z;
  const realv sum = gather_bounds(elements, blocks, block, lane);
  store_lanes(inverse_mass > zero ? sum * inverse_mass : zero,
              squares + (long)block * TLED_LANES + lane);
}

// Slot of the element that a corner force belongs to.
INLINE int element_of_place(int place) {
  return place / (24 * TLED_LANES) * TLED_LANES + place % TLED_LANES;
}

// The same of a conforming mesh. Work-item: a node.
__kernel void hex_node_squares(__global const real* restrict elements,
                               __global real* restrict squares,
                               __global const int* restrict blocks,
                               __global const real* restrict node_sets,
                               __global const int* restrict begin,
                               __global const int* restrict places, int n_slots) {
  const int slot = (int)get_global_id(0);
  if (slot >= n_slots) return;
  const int block = slot / TLED_LANES, lane = slot % TLED_LANES;
  __global const real* w = node_sets + (long)blocks[(long)block * TLED_BLOCK_INTS + BLOCK_NODE] *
                                           (TLED_NODE_ROWS * TLED_LANES) + lane;
  const real x = w[0], y = w[TLED_LANES], z = w[2 * TLED_LANES];
  const real of_two = x > y ? x : y, inverse_mass = of_two > z ? of_two : z;
  real sum = R(0.0);
  for (int i = begin[slot]; i < begin[slot + 1]; ++i) sum += elements[element_of_place(places[i])];
  squares[slot] = inverse_mass > R(0.0) ? sum * inverse_mass : R(0.0);
}

// Work-item: some rows of nodes. values[i]: the largest reached, with its slot; values[n_items + i]
// and values[2 n_items + i]: the largest exact/last and reached/exact, at least 1, of nodes above
// the threshold.
__kernel void largest_squares(__global const real* restrict reached,
                              __global const real* restrict exact,
                              __global const real* restrict last, __global const real* restrict look,
                              __global real* restrict values, __global int* restrict slots,
                              int n_rows, int n_items) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
  const int first = FIRST_ROW(item, n_rows, n_items), end = END_ROW(item, n_rows, n_items),
            step = ROW_STEP(n_items);
  const realv threshold = broadcast(look[LOOK_THRESHOLD]), one = broadcast(R(1.0));
  realv highest = broadcast(R(0.0)), place = highest, since = one, reach = one;
  int n = 0;  // of the row among this work-item's: exact in float32
  for (int row = first; row < end; row += step, ++n) {
    const long at = (long)row * ROW_LANES;
    const realv most = load_lanes(reached + at), now = load_lanes(exact + at);
    place = most > highest ? broadcast((real)n) : place;
    highest = most > highest ? most : highest;
    const realv grown = now > threshold ? now / load_lanes(last + at) : one,
                reaching = most > threshold ? most / now : one;
    since = grown > since ? grown : since;
    reach = reaching > reach ? reaching : reach;
  }
  real largest[3] = {R(0.0), R(1.0), R(1.0)};
  int slot = 0;
  for (int lane = 0; lane < ROW_LANES; ++lane) {
    const real value = lane_of(highest, lane), grown = lane_of(since, lane),
               reaching = lane_of(reach, lane);
    const int at = (first + (int)lane_of(place, lane) * step) * ROW_LANES + lane;
    if (value > largest[0] || (value == largest[0] && at < slot)) {
      largest[0] = value;
      slot = at;
    }
    largest[1] = grown > largest[1] ? grown : largest[1];
    largest[2] = reaching > largest[2] ? reaching : largest[2];
  }
  for (int i = 0; i < 3; ++i) values[i * n_items + item] = largest[i];
  slots[item] = slot;
}

// One work-item. found[1]: slot of the stiffest of the elements around the node in slot found[0].
__kernel void stiffest_element(__global int* restrict found, __global const real* restrict elements,
                               __global const int* restrict blocks) {
  if (get_global_id(0) > 0) return;
  const int lane = found[0] % TLED_LANES;
  real stiffest = R(0.0);
  for (int corner = 0; corner < 8; ++corner) {
    int b = found[0] / TLED_LANES, l = lane;
    if (corner & 2) {
      if (l < TLED_WIDTH) b = blocks[(long)b * TLED_BLOCK_INTS + BLOCK_PREV_Y];
      l = (l + TLED_LANES - TLED_WIDTH) % TLED_LANES;
    }
    if (corner & 4) b = blocks[(long)b * TLED_BLOCK_INTS + BLOCK_PREV_Z];
    if (corner & 1) {
      const int first = l % TLED_WIDTH == 0;
      if (first) b = blocks[(long)b * TLED_BLOCK_INTS + BLOCK_PREV_X];
      l += first ? TLED_WIDTH - 1 : -1;
    }
    const int slot = b * TLED_LANES + l;
    if (elements[slot] > stiffest) {
      stiffest = elements[slot];
      found[1] = slot;
    }
  }
}

// The same of a conforming mesh; stiffness is that over the volume.
__kernel void hex_stiffest_element(__global int* restrict found,
                                   __global const real* restrict elements,
                                   __global const real* restrict hex_rows,
                                   __global const int* restrict begin,
                                   __global const int* restrict places) {
  if (get_global_id(0) > 0) return;
  real stiffest = R(0.0);
  for (int i = begin[found[0]]; i < begin[found[0] + 1]; ++i) {
    const int slot = element_of_place(places[i]), block = slot / TLED_LANES, lane = slot % TLED_LANES;
    const real stiffness =
        elements[slot] / hex_rows[((long)block * TLED_HEX_ROWS + HEX_VOLUME) * TLED_LANES + lane];
    if (stiffness > stiffest) {
      stiffest = stiffness;
      found[1] = slot;
    }
  }
}
