// Shows that an OpenCL device compiles and computes rightly before anything trusts it: vector
// arithmetic, a swizzle and the mathematical functions that the material laws use.
// One work-item takes one row of 16 reals x > 0 and writes 2 x[l] + 3 x[l + 1 mod 16], by way of
// sqrt(x)^2 + exp(log(x)) = 2 x. No barriers.
#if TLED_DOUBLE
typedef double16 probe_row;
#else
typedef float16 probe_row;
#endif

__kernel void probe(__global const probe_row* values, __global probe_row* result,
                    const int n_rows) {
  const int row = (int)get_global_id(0);
  if (row >= n_rows) return;
  const probe_row x = values[row];
  const probe_row root = sqrt(x);
  const probe_row next = x.s123456789abcdef0;
  result[row] = mad(root, root, exp(log(x))) + next + next + next;
}
