// What is done to single nodes after each step, on the displacement u_next of its end: loads add
// what their force does to it, then prescribed components are overwritten. Lists of degrees of
// freedom, so that a step without conditions costs nothing. Only `real`: the same text serves rows
// and gather kernels. dofs: index of a real of u ((block * 3 + component) * TLED_LANES + lane).
// Columns of the step table: see csrc/sim/nodal_conditions.hpp. `step_index`: its row. What is given
// for the end of a node's step stands in the row of the last of the shortest steps in that.

// 1/m of a degree of freedom; 0 where it is held or prescribed.
INLINE int dof_level(__global const int* blocks, int dof) {
  const int block = dof / (3 * TLED_LANES);
  return NODE_LEVEL(blocks[(long)block * TLED_BLOCK_INTS + BLOCK_LEVELS]);
}

// dt^2 / (1 + a dt/2) of a degree of freedom; 0 where it is not due.
INLINE real dof_step_square(__global const int* blocks, __global const real* step, int dof) {
  __global const real* of_level = step + dof_level(blocks, dof) * TLED_STEP_LEVEL;
  return of_level[STEP_FORCE] * of_level[STEP_DUE];
}

INLINE real dof_inverse_mass(__global const int* blocks, __global const real* node_sets, int dof) {
  const int reals = TLED_NODE_ROWS * TLED_LANES;  // as many as a block has of u
  const int set = blocks[(long)(dof / reals) * TLED_BLOCK_INTS + BLOCK_NODE];
  return node_sets[(long)set * reals + dof % reals];
}

// Work-item: a degree of freedom. Entries begin[i] to begin[i + 1] are forces (N) on it, each for
// a factor of 1 in its column.
__kernel void apply_loads(__global real* restrict u_next, __global const int* restrict blocks,
                          __global const real* restrict node_sets,
                          __global const int* restrict dofs, __global const int* restrict begin,
                          __global const int* restrict columns,
                          __global const real* restrict forces,
                          __global const real* restrict step_table, int n, int step_index,
                          int step_reals) {
  const int i = (int)get_global_id(0);
  if (i >= n) return;
  __global const real* step = step_table + (long)step_index * step_reals;
  real force = R(0.0);
  for (int entry = begin[i]; entry < begin[i + 1]; ++entry)
    force += step[columns[entry]] * forces[entry];
  u_next[dofs[i]] += dof_step_square(blocks, step, dofs[i]) *
                     dof_inverse_mass(blocks, node_sets, dofs[i]) * force;
}

// Ints of a loaded face: dofs of the x components of its four corners, counter-clockwise seen from
// outside in the model's frame; column; row of face_shapes (the diagonals 0-2 and 1-3 at rest).
#define PRESSURE_FACE_INTS 6
#define PRESSURE_SHAPE_REALS 6

// Work-item: a node. The force on a corner is a quarter of pressure times the area vector of the
// deformed face, half the cross product of its diagonals: the column holds -p/8 with the sign of
// the solver's axes. Faces of a node are added in a fixed order.
__kernel void apply_pressure(__global const real* restrict u, __global real* restrict u_next,
                             __global const int* restrict blocks,
                             __global const real* restrict node_sets,
                             __global const int* restrict dofs, __global const int* restrict begin,
                             __global const int* restrict node_faces,
                             __global const int* restrict faces,
                             __global const real* restrict face_shapes,
                             __global const real* restrict step_table, int n, int step_index,
                             int step_reals) {
  const int i = (int)get_global_id(0);
  if (i >= n) return;
  __global const real* step = step_table + (long)step_index * step_reals;
  real fx = R(0.0), fy = R(0.0), fz = R(0.0);
  for (int entry = begin[i]; entry < begin[i + 1]; ++entry) {
    __global const int* face = faces + (long)node_faces[entry] * PRESSURE_FACE_INTS;
    __global const real* shape = face_shapes + face[5] * PRESSURE_SHAPE_REALS;
    const int a = face[0], b = face[1], c = face[2], d = face[3];
    const real px = shape[0] + u[c] - u[a], qx = shape[3] + u[d] - u[b];
    const real py = shape[1] + u[c + TLED_LANES] - u[a + TLED_LANES],
               qy = shape[4] + u[d + TLED_LANES] - u[b + TLED_LANES];
    const real pz = shape[2] + u[c + 2 * TLED_LANES] - u[a + 2 * TLED_LANES],
               qz = shape[5] + u[d + 2 * TLED_LANES] - u[b + 2 * TLED_LANES];
    const real p = step[face[4]];
    fx += p * (py * qz - pz * qy);
    fy += p * (pz * qx - px * qz);
    fz += p * (px * qy - py * qx);
  }
  const int dof = dofs[i];
  const real scale = dof_step_square(blocks, step, dof);
  u_next[dof] += scale * dof_inverse_mass(blocks, node_sets, dof) * fx;
  u_next[dof + TLED_LANES] += scale * dof_inverse_mass(blocks, node_sets, dof + TLED_LANES) * fy;
  u_next[dof + 2 * TLED_LANES] +=
      scale * dof_inverse_mass(blocks, node_sets, dof + 2 * TLED_LANES) * fz;
}

// Work-item: a degree of freedom and the column of its value.
__kernel void prescribe_values(__global real* restrict u_next, __global const int* restrict blocks,
                               __global const int* restrict dofs,
                               __global const int* restrict columns,
                               __global const real* restrict step_table, int n, int step_index,
                               int step_reals) {
  const int i = (int)get_global_id(0);
  if (i >= n) return;
  __global const real* step = step_table + (long)step_index * step_reals;
  const int level = dof_level(blocks, dofs[i]);
  if (step[level * TLED_STEP_LEVEL + STEP_DUE] == R(0.0)) return;
  u_next[dofs[i]] = step[((1 << level) - 1) * step_reals + columns[i]];
}

// Work-item: a degree of freedom. Between the key in `column` + 1 and the one behind it by the weight in
// `column`.
__kernel void prescribe_fields(__global real* restrict u_next, __global const int* restrict blocks,
                               __global const int* restrict dofs, __global const real* restrict keys,
                               __global const real* restrict step_table, int n, int step_index,
                               int step_reals, int column) {
  const int i = (int)get_global_id(0);
  if (i >= n) return;
  __global const real* step = step_table + (long)step_index * step_reals;
  const int level = dof_level(blocks, dofs[i]);
  if (step[level * TLED_STEP_LEVEL + STEP_DUE] == R(0.0)) return;
  __global const real* end = step + ((1 << level) - 1) * step_reals + column;
  const int key = (int)end[1];
  const real a = keys[(long)key * n + i], b = keys[(long)(key + 1) * n + i];
  u_next[dofs[i]] = a + end[0] * (b - a);
}
