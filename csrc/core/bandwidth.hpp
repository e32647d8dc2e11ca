// Copy bandwidth of the host's memory, measured: what every speed is reported beside.
#pragma once
#include <cstddef>
#include <vector>

namespace tledface {

// GB/s read + written by copying `bytes` with every thread of the pool; the best of `repeats`.
double copy_bandwidth(std::size_t bytes = std::size_t(256) << 20, int repeats = 3);

// The same in turns with something else: arrays that are kept.
class HostCopy {
 public:
  explicit HostCopy(std::size_t bytes = std::size_t(256) << 20) : from_(bytes, 1), to_(bytes, 0) {}
  double measure();  // GB/s of one copy

 private:
  std::vector<char> from_, to_;
};

}  // namespace tledface
