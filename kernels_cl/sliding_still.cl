// Sliding where a work-item has one node and surfaces stand still and neither rub nor let go: level 1 of
// sliding.cl for every node, levels 2 to 4 (sliding_queue.cl) for those that have left their balls, which
// wait in a queue. Few registers and no loop: a node that is sought for would hold up all of its warp.

// What level 1 reads of the node at a place, row of nodes * TLED_LANES + lane.
typedef struct {
  Ball ball;
  Plane plane;
  int shape;
} SlidingNode;
INLINE SlidingNode sliding_node(__global const real* slide_rows, __global const int* slide_ints, int row,
                                int lane) {
  __global const real* lanes = slide_rows + (long)row * (SLIDE_ROWS * TLED_LANES) + lane;
  const SlidingNode node = {ball_of(lanes), plane_of(lanes),
                            slide_ints[(row * SLIDE_INTS + SLIDE_SHAPE) * TLED_LANES + lane]};
  return node;
}

// Level 1 for that node at displacement u: it is put back to its distance, or waits in the queue, as it is.
// parity: whose number in the queue counts (sliding_layout.cl).
INLINE void hold_node(SlidingNode node, __global const real* slide_regions,
                      volatile __global int* slide_queue, int parity, int row, int lane, real u[3]) {
  __global const real* region = slide_regions + (long)row * (REGION_ROWS * TLED_LANES) + lane;
  const Points at = {u[0], u[1], u[2]};
  const int left = lanes_that_left(node.ball, at);
  // Whether it left or not: nearly none does, and all that is read is on its way at once.
  const Points back = moved_back(way_back(node.plane, region, node.shape, at), at);
  u[0] = left ? at.x : back.x;
  u[1] = left ? at.y : back.y;
  u[2] = left ? at.z : back.z;
  if (left) slide_queue[SLIDE_WAITING + atomic_inc(slide_queue + parity)] = row * TLED_LANES + lane;
}

// Work-item: the node at its place.
__kernel void slide_still(__global const real* restrict slide_rows,
                          __global const real* restrict slide_regions,
                          __global const int* restrict slide_ints,
                          __global int* restrict slide_queue, __global real* restrict u_next,
                          int n_places, int parity) {
  const int place = (int)get_global_id(0);
  if (place >= n_places) return;
  const int row = place / TLED_LANES, lane = place % TLED_LANES;
  __global real* at = u_next + slide_ints[(row * SLIDE_INTS + SLIDE_DOF) * TLED_LANES + lane];
  real u[3] = {at[0], at[TLED_LANES], at[2 * TLED_LANES]};
  hold_node(sliding_node(slide_rows, slide_ints, row, lane), slide_regions, slide_queue, parity, row,
            lane, u);
  for (int c = 0; c < 3; ++c) at[c * TLED_LANES] = u[c];
}
