// Eight of a zone's borders (kernels_cl/sliding_zone.cl). Included within the namespaces of
// shim.hpp and counted.hpp, whose `real` it takes, so once in each: no guard.

#define GROUP_LANES 8
typedef real realg __attribute__((vector_size(sizeof(real) * GROUP_LANES)));
typedef real realg_in_memory __attribute__((vector_size(sizeof(real) * GROUP_LANES), may_alias));
inline realg group_of(real x) { return x - realg{}; }
inline realg load_group(const real* p) { return *reinterpret_cast<const realg_in_memory*>(p); }
inline realg numbers_from(int first) {
  return realg{0, 1, 2, 3, 4, 5, 6, 7} + static_cast<real>(first);
}
inline real least_of(realg v) {
  realg other = __builtin_shufflevector(v, v, 4, 5, 6, 7, 0, 1, 2, 3);
  v = v < other ? v : other;
  other = __builtin_shufflevector(v, v, 2, 3, 0, 1, 6, 7, 4, 5);
  v = v < other ? v : other;
  return v[0] < v[1] ? v[0] : v[1];
}
// The first of the places where v is x; the last where it is nowhere.
inline int first_place_of(realg v, real x) {
#if defined(__AVX2__) && !TLED_DOUBLE
  const auto is = _mm256_cmp_ps((__m256)v, _mm256_set1_ps(x), _CMP_EQ_OQ);
  return __builtin_ctz(static_cast<unsigned>(_mm256_movemask_ps(is)) | 1u << (GROUP_LANES - 1));
#else
  int place = GROUP_LANES - 1;
  for (int k = GROUP_LANES - 1; k >= 0; --k)
    if (v[k] == x) place = k;
  return place;
#endif
}
