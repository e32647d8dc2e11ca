// OpenCL C's words for C++ with vector extensions (GCC, Clang): the twin of kernels_cl/dialect.cl.
// Included by kernel_table.cpp alone, once per instruction set and precision. Everything has
// internal linkage: a function that the linker shared between instruction sets would crash the
// processor that lacks one.
#pragma once

#ifndef TLED_LANES
#error "TLED_LANES: reals a vector row"
#endif
#if defined(__AVX2__)
#include <immintrin.h>
#endif

#define TLED_OPENCL 0
#define TLED_VECTOR_ROWS 1
#define __kernel static
#define __global
#define restrict __restrict__
#define LOADS_AHEAD 1

namespace {

#if TLED_DOUBLE
typedef double real;
#else
typedef float real;
#endif
#define R(x) (static_cast<real>(x))

typedef real realv __attribute__((vector_size(sizeof(real) * TLED_LANES)));
// Loads and stores go through this type: rows of a block are aligned and alias plain reals.
typedef real realv_in_memory __attribute__((vector_size(sizeof(real) * TLED_LANES), may_alias));
typedef real realv_anywhere
    __attribute__((vector_size(sizeof(real) * TLED_LANES), may_alias, aligned(sizeof(real))));

#include "backend/native/border_group.hpp"

thread_local unsigned long current_item = 0;
inline unsigned long get_global_id(unsigned) { return current_item; }

inline realv broadcast(real x) { return x - realv{}; }
inline realv load_lanes(const real* p) { return *reinterpret_cast<const realv_in_memory*>(p); }
inline void store_lanes(realv v, real* p) { *reinterpret_cast<realv_in_memory*>(p) = v; }
inline realv gather_lanes(const real* p, const int* at) {
  realv v{};
  for (int lane = 0; lane < TLED_LANES; ++lane) v[lane] = p[at[lane]];
  return v;
}
inline void prefetch_line(const real* p) { __builtin_prefetch(p, 1); }
inline void prefetch_to_read(const real* p) { __builtin_prefetch(p, 0); }
inline void prefetch_to_second(const real* p) { __builtin_prefetch(p, 0, 2); }
// The lanes of which a is not below b, as bits.
inline int lanes_not_below(realv a, realv b) {
#if defined(__AVX512F__)  // the loop below is not recognised
  return sizeof(real) == 4 ? _mm512_cmp_ps_mask((__m512)a, (__m512)b, _CMP_NLT_UQ)
                           : _mm512_cmp_pd_mask((__m512d)a, (__m512d)b, _CMP_NLT_UQ);
#elif defined(__AVX2__)
  return sizeof(real) == 4 ? _mm256_movemask_ps((__m256)(a < b)) ^ 0xff
                           : _mm256_movemask_pd((__m256d)(a < b)) ^ 0xf;
#else
  const auto below = a < b;
  int bits = 0;
  for (int lane = 0; lane < TLED_LANES; ++lane) bits |= (below[lane] == 0) << lane;
  return bits;
#endif
}
inline int lowest_bit(int bits) { return __builtin_ctz(static_cast<unsigned>(bits)); }
inline int all_below(realv a, realv b) { return lanes_not_below(a, b) == 0; }

// Blocks of four lanes along x and the rest along y: see dialect.cl.
#if TLED_LANES == 16 && !TLED_DOUBLE && defined(__AVX512BW__)
// One instruction each that the compiler does not find: its own take an index from memory.
inline realv next_in_x(realv own, realv next) {
  return (realv)_mm512_alignr_epi8((__m512i)next, (__m512i)own, 4);
}
inline realv next_in_y(realv own, realv next) {
  return (realv)_mm512_alignr_epi32((__m512i)next, (__m512i)own, 4);
}
inline realv previous_in_x(realv own, realv before) {
  return (realv)_mm512_alignr_epi8((__m512i)own, (__m512i)before, 12);
}
inline realv previous_in_y(realv own, realv before) {
  return (realv)_mm512_alignr_epi32((__m512i)own, (__m512i)before, 12);
}
inline realv previous_behind_edge(realv own, const real* edge, const int component) {
  const int e = 17 + component;
  const __m512i from =
      _mm512_setr_epi32(e, 0, 1, 2, e + 4, 4, 5, 6, e + 8, 8, 9, 10, e + 12, 12, 13, 14);
  return (realv)_mm512_permutex2var_ps((__m512)own, from, (__m512)load_lanes(edge));
}
inline void store_last(realv a, realv b, realv c, real* p) {
  const __m512 ends = _mm512_unpackhi_ps((__m512)b, (__m512)c);
  store_lanes((realv)_mm512_shuffle_ps((__m512)a, ends, _MM_SHUFFLE(3, 2, 3, 3)), p);
}
#elif TLED_LANES == 8 && !TLED_DOUBLE && defined(__AVX2__)
inline realv next_in_x(realv own, realv next) {
  return (realv)_mm256_alignr_epi8((__m256i)next, (__m256i)own, 4);
}
inline realv next_in_y(realv own, realv next) {
  return (realv)_mm256_permute2f128_ps((__m256)own, (__m256)next, 0x21);
}
inline realv previous_in_x(realv own, realv before) {
  return (realv)_mm256_alignr_epi8((__m256i)own, (__m256i)before, 12);
}
inline realv previous_in_y(realv own, realv before) {
  return (realv)_mm256_permute2f128_ps((__m256)before, (__m256)own, 0x21);
}
inline void store_last(realv a, realv b, realv c, real* p) {
  const __m256 ends = _mm256_unpackhi_ps((__m256)b, (__m256)c);
  store_lanes((realv)_mm256_shuffle_ps((__m256)a, ends, _MM_SHUFFLE(3, 2, 3, 3)), p);
}
#elif TLED_LANES == 8
inline realv next_in_x(realv own, realv next) {
  return __builtin_shufflevector(own, next, 1, 2, 3, 8, 5, 6, 7, 12);
}
inline realv next_in_y(realv own, realv next) {
  return __builtin_shufflevector(own, next, 4, 5, 6, 7, 8, 9, 10, 11);
}
inline realv previous_in_x(realv own, realv before) {
  return __builtin_shufflevector(own, before, 11, 0, 1, 2, 15, 4, 5, 6);
}
inline realv previous_in_y(realv own, realv before) {
  return __builtin_shufflevector(own, before, 12, 13, 14, 15, 0, 1, 2, 3);
}
inline void store_last(realv a, realv b, realv c, real* p) {
  const realv ends = __builtin_shufflevector(b, c, 3, 3, 3, 11, 7, 7, 7, 15);
  store_lanes(__builtin_shufflevector(a, ends, 3, 3, 10, 11, 7, 7, 14, 15), p);
}
#elif TLED_LANES == 4
inline realv next_in_x(realv own, realv next) {
  return __builtin_shufflevector(own, next, 1, 2, 3, 4);
}
inline realv next_in_y(realv, realv next) { return next; }
inline realv previous_in_x(realv own, realv before) {
  return __builtin_shufflevector(own, before, 7, 0, 1, 2);
}
inline realv previous_in_y(realv, realv before) { return before; }
inline void store_last(realv a, realv b, realv c, real* p) {
  const realv ends = __builtin_shufflevector(b, c, 3, 3, 3, 7);
  store_lanes(__builtin_shufflevector(a, ends, 3, 3, 6, 7), p);
}
#else
#error "TLED_LANES: 4, 8, or 16 of AVX-512"
#endif
#if TLED_LANES < 16
inline realv previous_behind_edge(realv own, const real* edge, const int component) {
  // From where the component is the last in x.
  return previous_in_x(own, *reinterpret_cast<const realv_anywhere*>(edge + component - 2));
}
#endif
inline real lane_of(realv v, int lane) { return v[lane]; }

// Loops over lanes: the compiler turns the first and last into one instruction a vector.
inline realv square_root(realv x) {
  realv y = x;
  for (int lane = 0; lane < TLED_LANES; ++lane)
    y[lane] = sizeof(real) == 4 ? __builtin_sqrtf(x[lane]) : __builtin_sqrt(x[lane]);
  return y;
}
inline realv natural_log(realv x) {
  realv y = x;
  for (int lane = 0; lane < TLED_LANES; ++lane)
    y[lane] = sizeof(real) == 4 ? __builtin_logf(x[lane]) : __builtin_log(x[lane]);
  return y;
}
inline realv natural_exp(realv x) {
  realv y = x;
  for (int lane = 0; lane < TLED_LANES; ++lane)
    y[lane] = sizeof(real) == 4 ? __builtin_expf(x[lane]) : __builtin_exp(x[lane]);
  return y;
}
inline realv absolute(realv x) {
  realv y = x;
  for (int lane = 0; lane < TLED_LANES; ++lane)
    y[lane] = sizeof(real) == 4 ? __builtin_fabsf(x[lane]) : __builtin_fabs(x[lane]);
  return y;
}

}  // namespace
