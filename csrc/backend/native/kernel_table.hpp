// The kernels of one instruction set and precision, as the native device calls them.
#pragma once
#include <cstdint>

namespace tledface::native {

union KernelArg {
  void* pointer;
  std::int32_t integer;
};

struct KernelEntry {
  const char* name;
  unsigned n_args;
  const bool* arg_is_pointer;
  // Runs work-items [begin, end).
  void (*run)(const KernelArg* args, unsigned long begin, unsigned long end);
};

struct KernelTable {
  const char* instruction_set;
  int lanes;
  const KernelEntry* entries;
  unsigned n_entries;
};

}  // namespace tledface::native
