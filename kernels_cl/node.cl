// Central differences of one component of one node, for the kernels whose work-item is a node.

// What all nodes of a step share, of a row of the step table.
typedef struct { real velocity, force, gravity[3]; } NodeMotion;

INLINE void set_motion(__global const real* step, NodeMotion* m) {
  m->velocity = step[STEP_VELOCITY];
  m->force = step[STEP_FORCE];
  for (int c = 0; c < 3; ++c) m->gravity[c] = step[STEP_GRAVITY + c];
}

// u_next = u + velocity (u - u_prev) - force f / m + gravity, zero increment where 1/m is 0.
INLINE real next_displacement(real now, real before, real inverse_mass, const NodeMotion* m, real f,
                              const int component) {
  const real next = now + m->velocity * (now - before) - (m->force * inverse_mass) * f;
  return inverse_mass > R(0.0) ? next + m->gravity[component] : next;
}
