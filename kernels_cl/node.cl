// Central differences of one component of one node, for the kernels whose work-item is a node.
// u_next = u + velocity (u - u_prev) - force f / m + gravity, zero increment where 1/m is 0.
INLINE real next_displacement(real now, real before, real inverse_mass,
                                     __global const real* step, real f, int component) {
  const real next =
      now + step[STEP_VELOCITY] * (now - before) - (step[STEP_FORCE] * inverse_mass) * f;
  return inverse_mass > R(0.0) ? next + step[STEP_GRAVITY + component] : next;
}
