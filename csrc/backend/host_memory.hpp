// Memory for arrays that every step walks.
#pragma once
#include <cstddef>

namespace tledface {

// Zero-filled, from a line of the cache on; large pages where it fills one and the system has them:
// looking up where a small page is costs as much as its lines. InputError where there is not
// enough.
class HostMemory {
 public:
  // From this size on pages are large.
  static constexpr std::size_t kLargePage = std::size_t(2) << 20;

  explicit HostMemory(std::size_t bytes);
  ~HostMemory();
  HostMemory(const HostMemory&) = delete;
  HostMemory& operator=(const HostMemory&) = delete;

  void* data() const { return data_; }

 private:
  void* data_ = nullptr;
};

}  // namespace tledface
