// What the C++ tests check with: a check that fails says where, and the test ends with 1.
#pragma once
#include <cstdio>
#include <cstdlib>

inline int failures = 0;

#define CHECK(condition)                                                           \
  do {                                                                             \
    if (!(condition)) {                                                            \
      std::fprintf(stderr, "%s:%d: failed: %s\n", __FILE__, __LINE__, #condition); \
      ++failures;                                                                  \
    }                                                                              \
  } while (false)

inline int finish(const char* name) {
  if (failures == 0) std::printf("%s: every check holds\n", name);
  return failures == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
