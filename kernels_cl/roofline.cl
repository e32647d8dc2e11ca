// What the device can do at best, beside which the solver's speed is reported: blocks of plain
// memory traffic and of plain arithmetic, with rows of lanes as the solver's kernels have them. A
// program of its own for OpenCL (dialect.cl alone before it); native kernels have it in their table.
#include "dialect.cl"

// A work-item's rows of lanes: where rows are vectors a piece of the array in one run, as a band of
// the solver; else every n_items-th real, so that neighbouring work-items read neighbours.
#if TLED_VECTOR_ROWS
#define FOR_ROWS_OF_ITEM(row)                                                  \
  for (long row = (long)n_rows * (long)get_global_id(0) / n_items,             \
            end = (long)n_rows * ((long)get_global_id(0) + 1) / n_items;       \
       row < end; ++row)
#define ROW_REALS TLED_LANES
#else
#define FOR_ROWS_OF_ITEM(row) \
  for (long row = (long)get_global_id(0); row < n_rows; row += n_items)
#define ROW_REALS 1
#endif

// y = y + a x in place: 3 reals an element.
__kernel void roofline_axpy(__global const real* restrict x, __global real* restrict y, int n_rows,
                            int n_items) {
  if ((int)get_global_id(0) >= n_items) return;
  const realv a = broadcast(R(1e-6));
  FOR_ROWS_OF_ITEM(row) {
    __global real* at = y + row * ROW_REALS;
    store_lanes(load_lanes(at) + a * load_lanes(x + row * ROW_REALS), at);
  }
}

// y = x: 2 reals an element.
__kernel void roofline_copy(__global const real* restrict x, __global real* restrict y, int n_rows,
                            int n_items) {
  if ((int)get_global_id(0) >= n_items) return;
  FOR_ROWS_OF_ITEM(row)
    store_lanes(load_lanes(x + row * ROW_REALS), y + row * ROW_REALS);
}

// Independent chains of operations, all in registers (16 of AVX2 hold 8 + 6 chains and 2
// constants): 8 that multiply, enough for two units with a latency of 4; 6 that add, for two with 3.
// A group is one operation of each multiplying chain with `adds` additions dealt between them.
#define FUSED(x) x = x * b + c
#define MULTIPLIED(x) x = x * b
#define ADDED(y) y = y + c
#define NO_ADD

#define GROUP(OP, a0, a1, a2, a3, a4, a5, a6, a7) \
  OP(x0); a0; OP(x1); a1; OP(x2); a2; OP(x3); a3; OP(x4); a4; OP(x5); a5; OP(x6); a6; OP(x7); a7

// Twice the group, so that the loop's own work is small.
#define RUN(a0, a1, a2, a3, a4, a5, a6, a7)                                \
  for (int round = 0; round < rounds; ++round) {                           \
    for (int i = 0; i < fused; ++i) {                                      \
      GROUP(FUSED, a0, a1, a2, a3, a4, a5, a6, a7);                        \
      GROUP(FUSED, a0, a1, a2, a3, a4, a5, a6, a7);                        \
    }                                                                      \
    for (int i = 0; i < multiplied; ++i) {                                 \
      GROUP(MULTIPLIED, a0, a1, a2, a3, a4, a5, a6, a7);                   \
      GROUP(MULTIPLIED, a0, a1, a2, a3, a4, a5, a6, a7);                   \
    }                                                                      \
  }

// `rounds` times 2 `fused` groups of multiply-adds and 2 `multiplied` groups of products, each with
// `adds` (0 to 12) additions. Work-item: a row of lanes, or a lane. out: one such row of zeros each,
// then one each for the result.
__kernel void roofline_mixed(__global real* restrict out, int n_items, int rounds, int fused,
                             int multiplied, int adds) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
  __global real* at = out + (long)item * ROW_REALS;
  // Values stay near 1: the products shrink them, the multiply-adds bring them back.
  const realv b = broadcast(R(0.9999)) + load_lanes(at), c = broadcast(R(0.0001)) + load_lanes(at);
  realv x0 = b, x1 = b + c, x2 = x1 + c, x3 = x2 + c, x4 = x3 + c, x5 = x4 + c, x6 = x5 + c,
        x7 = x6 + c;
  realv y0 = c, y1 = y0 + c, y2 = y1 + c, y3 = y2 + c, y4 = y3 + c, y5 = y4 + c;
  switch (adds) {
    case 0: RUN(NO_ADD, NO_ADD, NO_ADD, NO_ADD, NO_ADD, NO_ADD, NO_ADD, NO_ADD) break;
    case 1: RUN(ADDED(y0), NO_ADD, NO_ADD, NO_ADD, NO_ADD, NO_ADD, NO_ADD, NO_ADD) break;
    case 2: RUN(ADDED(y0), NO_ADD, NO_ADD, NO_ADD, ADDED(y1), NO_ADD, NO_ADD, NO_ADD) break;
    case 3: RUN(ADDED(y0), NO_ADD, NO_ADD, ADDED(y1), NO_ADD, NO_ADD, ADDED(y2), NO_ADD) break;
    case 4: RUN(ADDED(y0), NO_ADD, ADDED(y1), NO_ADD, ADDED(y2), NO_ADD, ADDED(y3), NO_ADD) break;
    case 5: RUN(ADDED(y0), NO_ADD, ADDED(y1), ADDED(y2), NO_ADD, ADDED(y3), NO_ADD, ADDED(y4)) break;
    case 6: RUN(ADDED(y0), ADDED(y1), NO_ADD, ADDED(y2), ADDED(y3), NO_ADD, ADDED(y4), ADDED(y5))
      break;
    case 7: RUN(ADDED(y0), ADDED(y1), ADDED(y2), ADDED(y3), ADDED(y4), ADDED(y5), ADDED(y0), NO_ADD)
      break;
    case 8: RUN(ADDED(y0), ADDED(y1), ADDED(y2), ADDED(y3), ADDED(y4), ADDED(y5), ADDED(y0),
                ADDED(y1)) break;
    case 9: RUN(ADDED(y0), ADDED(y1), ADDED(y2), ADDED(y3); ADDED(y4), ADDED(y5), ADDED(y0),
                ADDED(y1), ADDED(y2)) break;
    case 10: RUN(ADDED(y0), ADDED(y1); ADDED(y2), ADDED(y3), ADDED(y4), ADDED(y5), ADDED(y0);
                 ADDED(y1), ADDED(y2), ADDED(y3)) break;
    case 11: RUN(ADDED(y0), ADDED(y1); ADDED(y2), ADDED(y3), ADDED(y4); ADDED(y5), ADDED(y0),
                 ADDED(y1); ADDED(y2), ADDED(y3), ADDED(y4)) break;
    default: RUN(ADDED(y0); ADDED(y1), ADDED(y2), ADDED(y3); ADDED(y4), ADDED(y5), ADDED(y0);
                 ADDED(y1), ADDED(y2), ADDED(y3); ADDED(y4), ADDED(y5)) break;
  }
  store_lanes(x0 + x1 + x2 + x3 + x4 + x5 + x6 + x7 + y0 + y1 + y2 + y3 + y4 + y5,
              at + (long)n_items * ROW_REALS);
}
