// Memory of arrays that every step walks, and buffers in it: zero at first, whole pages, large ones
// where the system has them, natively and on CPUs that OpenCL lists.
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <limits>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include "backend/device.hpp"
#include "backend/host_memory.hpp"
#include "check.hpp"
#include "core/error.hpp"

using namespace tledface;

namespace {

constexpr std::size_t kLarge = HostMemory::kLargePage;

bool holds_only(const void* data, std::size_t bytes, unsigned char value) {
  const auto* at = static_cast<const unsigned char*>(data);
  for (std::size_t i = 0; i < bytes; ++i)
    if (at[i] != value) return false;
  return true;
}

// Twice: the second is what the first has left.
void test_it_is_zero_and_aligned() {
  for (const std::size_t bytes :
       {std::size_t(1), std::size_t(100), kLarge - 1, kLarge, 3 * kLarge + 5})
    for (int time = 0; time < 2; ++time) {
      const HostMemory memory(bytes);
      CHECK(holds_only(memory.data(), bytes, 0));
      const auto address = reinterpret_cast<std::uintptr_t>(memory.data());
      CHECK(address % (bytes < kLarge ? 64 : kLarge) == 0);
      std::memset(memory.data(), 0xff, bytes);
    }
}

bool is_refused(std::size_t bytes) {
  try {
    const HostMemory memory(bytes);
  } catch (const InputError& error) {
    return std::string(error.what()).find("not enough memory") != std::string::npos;
  }
  return false;
}

void test_too_much_is_refused() {
  constexpr std::size_t kMost = std::numeric_limits<std::size_t>::max();
  CHECK(is_refused(kMost));
#if !defined(__SANITIZE_ADDRESS__)  // which ends the program there
  CHECK(is_refused(kMost / 2));
#endif
}

// Whether the system was asked for large pages at an address; true where it has none to give.
bool asks_for_large_pages(const void* data) {
  std::ifstream modes("/sys/kernel/mm/transparent_hugepage/enabled"), maps("/proc/self/smaps");
  if (!modes || !maps) return true;
  const auto wanted = reinterpret_cast<std::uintptr_t>(data);
  bool is_inside = false;
  for (std::string line; std::getline(maps, line);) {
    unsigned long long begin = 0, end = 0;
    if (std::sscanf(line.c_str(), "%llx-%llx ", &begin, &end) == 2)
      is_inside = begin <= wanted && wanted < end;
    if (is_inside && line.rfind("VmFlags:", 0) == 0) {
      std::istringstream flags(line);
      for (std::string flag; flags >> flag;)
        if (flag == "hg") return true;
      return false;
    }
  }
  return false;
}

void test_large_arrays_ask_for_large_pages() {
  const HostMemory memory(2 * kLarge);
  CHECK(asks_for_large_pages(memory.data()));
}

void test_buffers_keep_what_is_written(Device& device) {
  for (const std::size_t bytes : {std::size_t(1000), kLarge + 12}) {
    auto buffer = device.allocate(bytes);
    std::vector<unsigned char> there(bytes, 1);
    buffer->read(there.data(), bytes);
    CHECK(holds_only(there.data(), bytes, 0));
    const std::vector<unsigned char> written(100, 7);
    buffer->write(written.data(), written.size(), bytes - 100);
    buffer->read(there.data(), bytes);
    CHECK(holds_only(there.data(), bytes - 100, 0));
    CHECK(holds_only(there.data() + bytes - 100, 100, 7));
    const auto reading = buffer->read_later();
    buffer->write(there.data() + bytes - 100, 100);
    CHECK(holds_only(reading->bytes(), 100, 0));
  }
}

// A buffer that goes while a launch still writes to it: what its memory is used for next is left
// alone.
void test_a_buffer_may_go_at_any_time(Device& device) {
  constexpr std::size_t kMuch = 8 * kLarge;
  constexpr std::int32_t kPasses = 100, kItems = 64;
  ProgramOptions options;
  options.lanes = device.preferred_lanes(options.precision);
  options.vector_rows = device.prefers_vector_rows();
  options.file = "roofline.cl";
  const auto kernel = device.build(options)->kernel("roofline_axpy");
  const auto x = device.allocate(kMuch);
  const std::vector<float> ones(kMuch / sizeof(float), 1.0f);
  x->write(ones.data(), kMuch);
  auto y = device.allocate(kMuch);
  kernel->set_arg(0, *x);
  kernel->set_arg(1, *y);
  const auto lanes = static_cast<std::size_t>(options.vector_rows ? options.lanes : 1);
  std::int32_t argument = 2;
  for (const std::int32_t value : {static_cast<std::int32_t>(ones.size() / lanes), kItems, kPasses})
    kernel->set_arg(static_cast<unsigned>(argument++), value);
  kernel->enqueue(kItems);
  device.flush();
  y.reset();
  const HostMemory next(kMuch);
  device.finish();
  CHECK(holds_only(next.data(), kMuch, 0));
}

}  // namespace

int main() {
  test_it_is_zero_and_aligned();
  test_too_much_is_refused();
  test_large_arrays_ask_for_large_pages();
  for (const DeviceInfo& info : all_devices()) {
    if (!info.works) continue;
    const auto device = open_device(info.id);
    test_buffers_keep_what_is_written(*device);
    test_a_buffer_may_go_at_any_time(*device);
  }
  return finish("host memory");
}
