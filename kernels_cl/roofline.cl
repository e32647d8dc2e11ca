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

// y = y + a x in place, 3 reals an element, `passes` times: small arrays are not to measure launches.
__kernel void roofline_axpy(__global const real* restrict x, __global real* restrict y, int n_rows,
                            int n_items, int passes) {
  if ((int)get_global_id(0) >= n_items) return;
  const realv a = broadcast(R(1e-6));
  for (int pass = 0; pass < passes; ++pass) {
    FOR_ROWS_OF_ITEM(row) {
      __global real* at = y + row * ROW_REALS;
      store_lanes(load_lanes(at) + a * load_lanes(x + row * ROW_REALS), at);
    }
  }
}

// y = x: 2 reals an element.
__kernel void roofline_copy(__global const real* restrict x, __global real* restrict y, int n_rows,
                            int n_items) {
  if ((int)get_global_id(0) >= n_items) return;
  FOR_ROWS_OF_ITEM(row)
    store_lanes(load_lanes(x + row * ROW_REALS), y + row * ROW_REALS);
}

// 14 independent chains of operations and one constant: what the 16 registers of AVX2 hold, and enough
// for four units with latencies of 4 and 3. Some chains add, the others multiply (and add).
#define FUSED(x) x = x * c + c;
#define MULTIPLIED(x) x = x * c;
#define ADDED(x) x = x + c;
#define CHAINS(o0, o1, o2, o3, o4, o5, o6, o7, o8, o9, o10, o11, o12, o13) \
  o0(x0) o1(x1) o2(x2) o3(x3) o4(x4) o5(x5) o6(x6) o7(x7) o8(x8) o9(x9) o10(x10) o11(x11) \
      o12(x12) o13(x13)
#define CHAINS_0(OP) \
  CHAINS(OP, OP, OP, OP, OP, OP, OP, OP, OP, OP, OP, OP, OP, OP)
#define CHAINS_1(OP) \
  CHAINS(OP, OP, OP, OP, OP, OP, ADDED, OP, OP, OP, OP, OP, OP, OP)
#define CHAINS_2(OP) \
  CHAINS(OP, OP, OP, ADDED, OP, OP, OP, OP, OP, OP, ADDED, OP, OP, OP)
#define CHAINS_3(OP) \
  CHAINS(OP, OP, ADDED, OP, OP, OP, ADDED, OP, OP, OP, OP, ADDED, OP, OP)
#define CHAINS_4(OP) \
  CHAINS(OP, ADDED, OP, OP, OP, ADDED, OP, OP, ADDED, OP, OP, OP, ADDED, OP)
#define CHAINS_5(OP) \
  CHAINS(OP, ADDED, OP, OP, ADDED, OP, ADDED, OP, OP, ADDED, OP, OP, ADDED, OP)
#define CHAINS_6(OP) \
  CHAINS(OP, ADDED, OP, ADDED, OP, ADDED, OP, OP, ADDED, OP, ADDED, OP, ADDED, OP)
#define CHAINS_7(OP) \
  CHAINS(ADDED, OP, ADDED, OP, ADDED, OP, ADDED, OP, ADDED, OP, ADDED, OP, ADDED, OP)
#define CHAINS_8(OP) \
  CHAINS(ADDED, OP, ADDED, OP, ADDED, OP, ADDED, ADDED, OP, ADDED, OP, ADDED, OP, ADDED)

// Four times each, so that the loop's own work is small.
#define RUN(chains)                                                                             \
  for (int round = 0; round < rounds; ++round) {                                                \
    for (int i = 0; i < fused; ++i) {                                                           \
      chains(FUSED) chains(FUSED) chains(FUSED) chains(FUSED)                                   \
    }                                                                                           \
    for (int i = 0; i < multiplied; ++i) {                                                      \
      chains(MULTIPLIED) chains(MULTIPLIED) chains(MULTIPLIED) chains(MULTIPLIED)               \
    }                                                                                           \
  }                                                                                             \
  break;

// `rounds` times `fused` (at least 1) times all chains with multiply-adds and `multiplied` times all
// with products, four times over; `adding` of the chains add instead, 0 to 8. Work-item: a row of
// lanes, or a lane. out: one such row of zeros each, then one each for the result.
__kernel void roofline_mixed(__global real* restrict out, int n_items, int rounds, int fused,
                             int multiplied, int adding) {
  const int item = (int)get_global_id(0);
  if (item >= n_items) return;
  __global real* at = out + (long)item * ROW_REALS;
  // x = x/2 + 1/2 tends to 1; products shrink it by 2 each and the next multiply-adds bring it back.
  const realv c = broadcast(R(0.5)) + load_lanes(at);
  realv x0 = c, x1 = x0 + c, x2 = x1 + c, x3 = x2 + c, x4 = x3 + c, x5 = x4 + c, x6 = x5 + c, x7 =
        x6 + c, x8 = x7 + c, x9 = x8 + c, x10 = x9 + c, x11 = x10 + c, x12 = x11 + c, x13 = x12 + c;
  switch (adding) {
    case 0: RUN(CHAINS_0)
    case 1: RUN(CHAINS_1)
    case 2: RUN(CHAINS_2)
    case 3: RUN(CHAINS_3)
    case 4: RUN(CHAINS_4)
    case 5: RUN(CHAINS_5)
    case 6: RUN(CHAINS_6)
    case 7: RUN(CHAINS_7)
    default: RUN(CHAINS_8)
  }
  store_lanes(x0 + x1 + x2 + x3 + x4 + x5 + x6 + x7 + x8 + x9 + x10 + x11 + x12 + x13, at +
              (long)n_items * ROW_REALS);
}
