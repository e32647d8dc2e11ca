// The few words that differ between OpenCL C and C++ with vector extensions. Kernels use only
// these, operators, and `condition ? a : b`, which selects lane by lane in both. The C++ twin is
// csrc/backend/native/shim.hpp; it defines the same names.
// Everything is inlined: flags such as `physical` are then constants, and vectors stay in registers.
#define INLINE static inline __attribute__((always_inline))

// The rare and large: kept out of the fused loop, whose registers it would take.
#define OUT_OF_LINE static __attribute__((noinline))

// Reals of a line of the cache.
#define LINE_REALS (64 / (int)sizeof(real))

#if TLED_OPENCL

#if TLED_DOUBLE
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
#else
typedef float real;
#endif
#define R(x) ((real)(x))

// A line of memory that is soon read and written, or only read; or only read and not yet wanted in the
// first cache. OpenCL C's own prefetch is empty on CPUs.
#if TLED_VECTOR_ROWS && defined(__has_builtin)
#if __has_builtin(__builtin_prefetch)
#define prefetch_line(p) __builtin_prefetch((const void*)(size_t)(p), 1)
#define prefetch_to_read(p) __builtin_prefetch((const void*)(size_t)(p), 0)
#define prefetch_to_second(p) __builtin_prefetch((const void*)(size_t)(p), 0, 2)
#endif
#endif
#ifndef prefetch_line
#define prefetch_line(p) (void)(p)
#define prefetch_to_read(p) (void)(p)
#define prefetch_to_second(p) (void)(p)
#endif

// Rows load an element's upper face while the element below is still at work, and do two blocks one
// after the other. LLVM, by which PoCL compiles, orders the instructions itself: to load ahead costs
// up to 5 % there, and two blocks 40 % more time to compile.
#define LOADS_AHEAD 0

#if !TLED_VECTOR_ROWS

// A group of a zone's borders (sliding_zone.cl): here one.
#define GROUP_LANES 1
typedef real realg;
INLINE realg group_of(real x) { return x; }
INLINE realg load_group(__global const real* p) { return *p; }
INLINE realg numbers_from(int first) { return (real)first; }
INLINE real least_of(realg v) { return v; }
INLINE int first_place_of(realg v, real x) { return 0; }

typedef real realv;
INLINE realv broadcast(real x) { return x; }
INLINE realv load_lanes(__global const real* p) { return *p; }
INLINE void store_lanes(realv v, __global real* p) { *p = v; }
INLINE realv gather_lanes(__global const real* p, __global const int* at) { return p[*at]; }
INLINE int all_below(realv a, realv b) { return a < b; }
INLINE int lanes_not_below(realv a, realv b) { return !(a < b); }
INLINE real lane_of(realv v, int lane) { return v; }

#else

#define TLED_JOIN2(a, b) a##b
#define TLED_JOIN(a, b) TLED_JOIN2(a, b)
#if TLED_DOUBLE
typedef TLED_JOIN(double, TLED_LANES) realv;
typedef double8 realg;
#else
typedef TLED_JOIN(float, TLED_LANES) realv;
typedef float8 realg;
#endif
#define GROUP_LANES 8
INLINE realg group_of(real x) { return (realg)(x); }
INLINE realg load_group(__global const real* p) { return *(__global const realg*)p; }
// first, first + 1 and so on.
INLINE realg numbers_from(int first) {
  return (realg)(0, 1, 2, 3, 4, 5, 6, 7) + (realg)((real)first);
}
INLINE real least_of(realg v) {
  v = min(v, v.s45670123);
  v = min(v, v.s23016745);
  return min(v.s0, v.s1);
}
// The first of the places where v is x; the last where it is nowhere.
INLINE int first_place_of(realg v, real x) {
  return (int)least_of(v == (realg)(x) ? numbers_from(0) : (realg)((real)(GROUP_LANES - 1)));
}
INLINE realv broadcast(real x) { return (realv)(x); }
INLINE realv load_lanes(__global const real* p) { return *(__global const realv*)p; }
INLINE void store_lanes(realv v, __global real* p) { *(__global realv*)p = v; }

// Lane l of the result is p[at[l]].
INLINE realv gather_lanes(__global const real* p, __global const int* at) {
  realv v;
  real* lane = (real*)&v;
  for (int l = 0; l < TLED_LANES; ++l) lane[l] = p[at[l]];
  return v;
}
// What a comparison of a row gives, all bits of a lane or none, and halves of it.
#if TLED_DOUBLE
#define TLED_MASK long
#else
#define TLED_MASK int
#endif
typedef TLED_JOIN(TLED_MASK, 16) mask16;
typedef TLED_JOIN(TLED_MASK, 8) mask8;
typedef TLED_JOIN(TLED_MASK, 4) mask4;
INLINE int bits_of4(mask4 m) { return (int)(m.s0 | m.s1 | m.s2 | m.s3); }
INLINE int bits_of8(mask8 m) { return bits_of4(m.lo | m.hi); }
INLINE int bits_of16(mask16 m) { return bits_of8(m.lo | m.hi); }
// The lanes of which a is not below b, as bits: folded, since PoCL's all() asks lane by lane.
INLINE int lanes_not_below(realv a, realv b) {
#if TLED_LANES == 16
  return bits_of16(~(a < b) & (mask16)(1, 2, 4, 8, 1 << 4, 1 << 5, 1 << 6, 1 << 7, 1 << 8, 1 << 9,
                                       1 << 10, 1 << 11, 1 << 12, 1 << 13, 1 << 14, 1 << 15));
#elif TLED_LANES == 8
  return bits_of8(~(a < b) & (mask8)(1, 2, 4, 8, 1 << 4, 1 << 5, 1 << 6, 1 << 7));
#else
  return bits_of4(~(a < b) & (mask4)(1, 2, 4, 8));
#endif
}
INLINE int all_below(realv a, realv b) { return lanes_not_below(a, b) == 0; }
INLINE real lane_of(realv v, int lane) { return ((const real*)&v)[lane]; }

// A block of lanes is TLED_WIDTH of them along x and the rest along y, x first (layout.cl). A lane takes
// what is one on in x or y: of the last ones from the block behind, `next`.
// One before likewise: of the first ones from the block before, `before`.
// store_last: an edge, of each y three values of the lane that is last in x, behind the place of a fourth;
// previous_behind_edge: one before in x, of the first ones the component of an edge.
#if TLED_LANES == 16
INLINE realv next_in_x(realv own, realv next) {
  return (realv)(own.s1, own.s2, own.s3, next.s0, own.s5, own.s6, own.s7, next.s4, own.s9, own.sa,
                 own.sb, next.s8, own.sd, own.se, own.sf, next.sc);
}
INLINE realv next_in_y(realv own, realv next) { return (realv)(own.s4567, own.s89abcdef, next.s0123); }
INLINE realv previous_in_x(realv own, realv before) {
  return (realv)(before.s3, own.s0, own.s1, own.s2, before.s7, own.s4, own.s5, own.s6, before.sb,
                 own.s8, own.s9, own.sa, before.sf, own.sc, own.sd, own.se);
}
INLINE realv previous_in_y(realv own, realv before) { return (realv)(before.scdef, own.s01234567, own.s89ab); }
INLINE void store_last(realv a, realv b, realv c, __global real* p) {
  store_lanes((realv)(a.s3, a.s3, b.s3, c.s3, a.s7, a.s7, b.s7, c.s7, a.sb, a.sb, b.sb, c.sb, a.sf,
                      a.sf, b.sf, c.sf), p);
}
INLINE realv edge_lanes(realv e, const int component) {
  if (component == 0) return e.s111155559999dddd;
  if (component == 1) return e.s22226666aaaaeeee;
  return e;
}
#elif TLED_LANES == 8
INLINE realv next_in_x(realv own, realv next) {
  return (realv)(own.s1, own.s2, own.s3, next.s0, own.s5, own.s6, own.s7, next.s4);
}
INLINE realv next_in_y(realv own, realv next) { return (realv)(own.hi, next.lo); }
INLINE realv previous_in_x(realv own, realv before) {
  return (realv)(before.s3, own.s0, own.s1, own.s2, before.s7, own.s4, own.s5, own.s6);
}
INLINE realv previous_in_y(realv own, realv before) { return (realv)(before.hi, own.lo); }
INLINE void store_last(realv a, realv b, realv c, __global real* p) {
  store_lanes((realv)(a.s3, a.s3, b.s3, c.s3, a.s7, a.s7, b.s7, c.s7), p);
}
INLINE realv edge_lanes(realv e, const int component) {
  if (component == 0) return e.s11115555;
  if (component == 1) return e.s22226666;
  return e;
}
#elif TLED_LANES == 4
INLINE realv next_in_x(realv own, realv next) { return (realv)(own.s1, own.s2, own.s3, next.s0); }
INLINE realv next_in_y(realv own, realv next) { return next; }
INLINE realv previous_in_x(realv own, realv before) {
  return (realv)(before.s3, own.s0, own.s1, own.s2);
}
INLINE realv previous_in_y(realv own, realv before) { return before; }
INLINE void store_last(realv a, realv b, realv c, __global real* p) {
  store_lanes((realv)(a.s3, a.s3, b.s3, c.s3), p);
}
INLINE realv edge_lanes(realv e, const int component) {
  if (component == 0) return e.s1111;
  if (component == 1) return e.s2222;
  return e;
}
#else
#error "TLED_LANES must be 4, 8 or 16"
#endif
INLINE realv previous_behind_edge(realv own, __global const real* edge, const int component) {
  return previous_in_x(own, edge_lanes(load_lanes(edge), component));
}

#endif  // TLED_VECTOR_ROWS

// The number of the lowest bit that is set.
INLINE int lowest_bit(int bits) { return 31 - (int)clz(bits & -bits); }

INLINE realv square_root(realv x) { return sqrt(x); }
INLINE realv natural_log(realv x) { return log(x); }
INLINE realv natural_exp(realv x) { return exp(x); }
INLINE realv absolute(realv x) { return fabs(x); }

#endif  // TLED_OPENCL
