#include "backend/host_memory.hpp"

#if defined(__linux__)
#include <sys/mman.h>
#endif

#include <cstdlib>
#include <cstring>
#include <string>

#include "core/error.hpp"

namespace tledface {
namespace {

constexpr std::size_t kLine = 64;  // of the cache, and the widest vector

}  // namespace

HostMemory::HostMemory(std::size_t bytes) {
  const std::size_t alignment = bytes < kLargePage ? kLine : kLargePage,
                    whole = (bytes + alignment - 1) / alignment * alignment;
  // Rounded up past the largest number it would be a small array.
  if (whole >= bytes) data_ = std::aligned_alloc(alignment, whole ? whole : alignment);
  if (!data_)
    throw InputError("not enough memory: an array of " + std::to_string(bytes >> 20) +
                     " MiB could not be had; take larger voxels or a smaller region");
#if defined(MADV_HUGEPAGE)
  if (bytes >= kLargePage) {
    madvise(data_, whole, MADV_HUGEPAGE);  // a wish: small ones do too
    madvise(data_, whole, MADV_DONTNEED);  // what was in use before would keep its small ones
  }
#endif
  std::memset(data_, 0, whole);
}

HostMemory::~HostMemory() { std::free(data_); }

}  // namespace tledface
