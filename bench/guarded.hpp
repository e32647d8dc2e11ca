// How both benchmarks end when something is wrong: one line; 2 for wrong usage, 1 for the rest.
#pragma once
#include <cstdio>
#include <exception>

#include "core/error.hpp"

namespace tledface::bench {

inline int guarded(const char* name, int (*run)(int, char**), int argc, char** argv) {
  const auto report = [name](const std::exception& error, int code) {
    std::fprintf(stderr, "%s: error: %s\n", name, error.what());
    return code;
  };
  try {
    return run(argc, argv);
  } catch (const InputError& error) {
    return report(error, 2);
  } catch (const std::exception& error) {
    return report(error, 1);
  }
}

}  // namespace tledface::bench
