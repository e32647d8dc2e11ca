// Copy bandwidth of the host's memory, measured: what every speed is reported beside.
#pragma once
#include <cstddef>

namespace tledface {

// GB/s read + written by copying `bytes` with every thread of the pool; the best of `repeats`.
double copy_bandwidth(std::size_t bytes = std::size_t(256) << 20, int repeats = 3);

}  // namespace tledface
