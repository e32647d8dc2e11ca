// What an element holds, for output and checks: F, Cauchy stress and energies; and the growth of its
// stiffness, for the masses of relaxation. Runs rarely (in float64 on the host), so it is plain.

// Modes of the displacement of the elements of one block.
INLINE ElementModes load_modes(__global const real* u, __global const int* blocks, int block) {
  Face low, high;
  load_face(u, blocks, block, &low);
  load_face(u, blocks, block + 1, &high);
  ElementModes m;
  m.linear = linear_modes(&low, &high);
  m.hourglass.xy = mode_xy(&low, &high);
  m.hourglass.yz = mode_yz(&low, &high);
  m.hourglass.zx = mode_zx(&low, &high);
  m.hourglass.xyz = mode_xyz(&low, &high);
  return m;
}

// stiffness_growth of a row's elements; -1 where J <= 0. Without element it means nothing.
INLINE realv known_growth(Tensor F, Symmetric G, __global const real* parameters) {
  const Tensor cof = cofactors(F);
  const realv J = volume_ratio(F, cof, parameters);
  return J > R(0.0) ? stiffness_growth(cof, J, G) : broadcast(R(-1.0));
}

// Work-item: a block. growth[block * TLED_LANES + lane].
__kernel void element_growth(__global const real* restrict u, __global real* restrict growth,
                             __global const int* restrict blocks,
                             __global const real* restrict materials,
                             __global const real* restrict shape, int n_blocks) {
  const int block = (int)get_global_id(0);
  if (block >= n_blocks) return;
  const int material = blocks[(long)block * TLED_BLOCK_INTS + BLOCK_MATERIAL];
  if (material < 0) return;
  const Tensor F =
      deformation_gradient(load_modes(u, blocks, block).linear, voxel_gradient(shape, 0));
  store_lanes(known_growth(F, voxel_spread(shape),
                           materials + (long)material * (TLED_MATERIAL_ROWS * TLED_LANES)),
              growth + (long)block * TLED_LANES);
}

// F, Cauchy stress and energies of a block's elements. P: Pa, without the hourglass centre term, so
// the element's mean; hourglass: J/m3.
INLINE void store_state(ElementTables t, Kinematics k, Tensor P, __global const real* parameters,
                        __global const int* links, realv hourglass, __global real* out) {
  const Tensor F = k.F;
  realv energy = base_energy(parameters, k);
  for (int i = links[BLOCK_LAW_BEGIN]; i < links[BLOCK_LAW_END]; ++i) {
    __global const int* entry = t.law_entries + TLED_LAW_ENTRY * i;
    energy += law_energy(entry[0], k, t.law_sets + (long)entry[1] * TLED_LANES,
                         law_state(t, entry, 0, 0));
  }
  store_lanes(F.xx, out);
  store_lanes(F.xy, out + TLED_LANES);
  store_lanes(F.xz, out + 2 * TLED_LANES);
  store_lanes(F.yx, out + 3 * TLED_LANES);
  store_lanes(F.yy, out + 4 * TLED_LANES);
  store_lanes(F.yz, out + 5 * TLED_LANES);
  store_lanes(F.zx, out + 6 * TLED_LANES);
  store_lanes(F.zy, out + 7 * TLED_LANES);
  store_lanes(F.zz, out + 8 * TLED_LANES);
  out += STATE_SIGMA * TLED_LANES;  // sigma = P F^T / J
  store_lanes((P.xx * F.xx + P.xy * F.xy + P.xz * F.xz) * k.inverse_J, out);
  store_lanes((P.yx * F.yx + P.yy * F.yy + P.yz * F.yz) * k.inverse_J, out + TLED_LANES);
  store_lanes((P.zx * F.zx + P.zy * F.zy + P.zz * F.zz) * k.inverse_J, out + 2 * TLED_LANES);
  store_lanes((P.xx * F.yx + P.xy * F.yy + P.xz * F.yz) * k.inverse_J, out + 3 * TLED_LANES);
  store_lanes((P.yx * F.zx + P.yy * F.zy + P.yz * F.zz) * k.inverse_J, out + 4 * TLED_LANES);
  store_lanes((P.xx * F.zx + P.xy * F.zy + P.xz * F.zz) * k.inverse_J, out + 5 * TLED_LANES);
  out += 6 * TLED_LANES;
  store_lanes(energy, out);
  store_lanes(hourglass, out + TLED_LANES);
}

// Both hourglass forms are quadratic in s at fixed F: the energy is half of s . f.
INLINE realv hourglass_energy(Hourglass s, Hourglass f) {
  return R(0.5) * (dot_product(s.xy, f.xy) + dot_product(s.yz, f.yz) + dot_product(s.zx, f.zx) +
                   dot_product(s.xyz, f.xyz));
}

// Work-item: a block. history: as the steps left it; nothing of it is changed.
__kernel void element_state(
    __global const real* restrict u, __global real* restrict state,
    __global const int* restrict blocks, __global const real* restrict materials,
    __global const int* restrict law_entries, __global const real* restrict law_sets,
    __global const real* restrict history, __global real* restrict next_history,
    __global const int* restrict muscle_entries, __global const real* restrict muscle_sets,
    __global const real* restrict muscle_constants, __global const real* restrict shape,
    __global const real* restrict step, int n_blocks, int physical) {
  const int block = (int)get_global_id(0);
  if (block >= n_blocks) return;
  __global const int* links = blocks + (long)block * TLED_BLOCK_INTS;
  if (links[BLOCK_MATERIAL] < 0) return;
  const ElementTables t = {blocks,           materials,    law_entries,
                           law_sets,         history,      next_history,
                           muscle_entries,   muscle_sets,  muscle_constants,
                           shape,            step};
  __global const real* parameters =
      materials + (long)links[BLOCK_MATERIAL] * (TLED_MATERIAL_ROWS * TLED_LANES);
  const ElementModes m = load_modes(u, blocks, block);
  const Kinematics k =
      kinematics(deformation_gradient(m.linear, voxel_gradient(shape, 0)), parameters);
  Tensor P = scaled_stress(t, k, parameters, links, 0, 0);
  const real wx = shape[SHAPE_FORCE], wy = shape[SHAPE_FORCE + 1], wz = shape[SHAPE_FORCE + 2];
  Tensor unused = P;
  Hourglass f;
  if (physical)
    f = physical_hourglass(parameters, shape, m.hourglass, k.cof, k.inverse_J, &unused);
  else
    f = kappa_hourglass(parameters, m.hourglass);
  const real volume = wx / shape[SHAPE_GRADIENT];  // (V/4h)/(1/4h)
  P.xx *= R(1.0) / wx;
  P.yx *= R(1.0) / wx;
  P.zx *= R(1.0) / wx;
  P.xy *= R(1.0) / wy;
  P.yy *= R(1.0) / wy;
  P.zy *= R(1.0) / wy;
  P.xz *= R(1.0) / wz;
  P.yz *= R(1.0) / wz;
  P.zz *= R(1.0) / wz;
  store_state(t, k, P, parameters, links, hourglass_energy(m.hourglass, f) * (R(1.0) / volume),
              state + (long)block * (TLED_STATE_ROWS * TLED_LANES));
}

// The same of a conforming mesh.
__kernel void hex_state(
    __global const real* restrict u, __global real* restrict state,
    __global const int* restrict blocks, __global const real* restrict materials,
    __global const int* restrict law_entries, __global const real* restrict law_sets,
    __global const real* restrict history, __global real* restrict next_history,
    __global const int* restrict muscle_entries, __global const real* restrict muscle_sets,
    __global const real* restrict muscle_constants, __global const real* restrict shape,
    __global const real* restrict step, __global const int* restrict hex_nodes,
    __global const real* restrict hex_rows, int n_blocks, int physical) {
  const int block = (int)get_global_id(0);
  if (block >= n_blocks) return;
  __global const int* links = blocks + (long)block * TLED_BLOCK_INTS;
  if (links[BLOCK_MATERIAL] < 0) return;
  const ElementTables t = {blocks,           materials,    law_entries,
                           law_sets,         history,      next_history,
                           muscle_entries,   muscle_sets,  muscle_constants,
                           shape,            step};
  __global const real* parameters =
      materials + (long)links[BLOCK_MATERIAL] * (TLED_MATERIAL_ROWS * TLED_LANES);
  const HexElement e = hex_element(hex_nodes, hex_rows, block, 0);
  const ElementModes m = hex_modes(e, u);
  const Kinematics k = kinematics(plus_identity(m.linear), parameters);
  const Tensor P = scaled_stress(t, k, parameters, links, 0, 0);
  Tensor unused = P;
  Hourglass f;
  if (physical)
    f = hex_hourglass(e, parameters, m.hourglass, k, 1, &unused);
  else
    f = hex_hourglass(e, parameters, m.hourglass, k, 0, &unused);
  store_state(t, k, P, parameters, links,
              hourglass_energy(m.hourglass, f) / hex_row(e, HEX_VOLUME),
              state + (long)block * (TLED_STATE_ROWS * TLED_LANES));
}

// element_growth of a conforming mesh.
__kernel void hex_growth(__global const real* restrict u, __global real* restrict growth,
                         __global const int* restrict blocks,
                         __global const real* restrict materials,
                         __global const int* restrict hex_nodes,
                         __global const real* restrict hex_rows, int n_blocks) {
  const int block = (int)get_global_id(0);
  if (block >= n_blocks) return;
  const int material = blocks[(long)block * TLED_BLOCK_INTS + BLOCK_MATERIAL];
  if (material < 0) return;
  const HexElement e = hex_element(hex_nodes, hex_rows, block, 0);
  store_lanes(known_growth(plus_identity(hex_modes(e, u).linear), hex_spread(e),
                           materials + (long)material * (TLED_MATERIAL_ROWS * TLED_LANES)),
              growth + (long)block * TLED_LANES);
}
