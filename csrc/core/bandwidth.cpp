#include "core/bandwidth.hpp"

#include <algorithm>
#include <chrono>
#include <cstring>
#include <vector>

#include "core/threads.hpp"

namespace tledface {

double copy_bandwidth(std::size_t bytes, int repeats) {
  const std::vector<char> from(bytes, 1);
  std::vector<char> to(bytes, 0);
  const std::size_t parts = thread_count(), part_bytes = bytes / parts;
  double best = 0;
  for (int repeat = 0; repeat < repeats; ++repeat) {
    const auto begin = std::chrono::steady_clock::now();
    parallel_for(parts, [&](std::size_t part) {
      std::memcpy(&to[part * part_bytes], &from[part * part_bytes], part_bytes);
    });
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;
    best = std::max(best, 2.0 * static_cast<double>(parts * part_bytes) / taken.count() / 1e9);
  }
  return best;
}

}  // namespace tledface
