#include "core/bandwidth.hpp"

#include <algorithm>
#include <chrono>
#include <cstring>

#include "core/threads.hpp"

namespace tledface {

double HostCopy::measure() {
  const std::size_t parts = thread_count(), part_bytes = from_.size() / parts;
  const auto begin = std::chrono::steady_clock::now();
  parallel_for(parts, [&](std::size_t part) {
    std::memcpy(&to_[part * part_bytes], &from_[part * part_bytes], part_bytes);
  });
  const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;
  return 2.0 * static_cast<double>(parts * part_bytes) / taken.count() / 1e9;
}

double copy_bandwidth(std::size_t bytes, int repeats) {
  HostCopy copy(bytes);
  double best = 0;
  for (int repeat = 0; repeat < repeats; ++repeat) best = std::max(best, copy.measure());
  return best;
}

}  // namespace tledface
