// The native executor: kernels compiled ahead of time for several instruction sets, the best one
// that this processor has taken at run time, work-items dealt to the thread pool.
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <utility>

#include "backend/device.hpp"
#include "backend/host_memory.hpp"
#include "backend/launch_log.hpp"
#include "backend/native/kernel_table.hpp"
#include "backend/native/operation_counts.hpp"
#include "core/error.hpp"
#include "core/threads.hpp"

namespace tledface {
namespace native {
const KernelTable& portable_float();
const KernelTable& portable_double();
const KernelTable& counted_float();
#if TLEDFACE_X86
const KernelTable& avx2_float();
const KernelTable& avx2_double();
const KernelTable& avx512_float();
const KernelTable& avx512_double();
#endif

namespace {

enum class InstructionSet { kPortable, kAvx2, kAvx512 };

InstructionSet best_instruction_set() {
  InstructionSet best = InstructionSet::kPortable;
#if TLEDFACE_X86
  __builtin_cpu_init();
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) best = InstructionSet::kAvx2;
  if (best == InstructionSet::kAvx2 && __builtin_cpu_supports("avx512f") &&
      __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
    best = InstructionSet::kAvx512;
#endif
  return best;
}

// TLEDFACE_INSTRUCTION_SET asks for a lesser one: tests run all that the machine has.
InstructionSet chosen_instruction_set() {
  const InstructionSet best = best_instruction_set();
  const char* wanted = std::getenv("TLEDFACE_INSTRUCTION_SET");
  if (!wanted || !*wanted) return best;
  const std::pair<const char*, InstructionSet> known[] = {{"portable", InstructionSet::kPortable},
                                                          {"avx2", InstructionSet::kAvx2},
                                                          {"avx512", InstructionSet::kAvx512}};
  for (const auto& [name, set] : known)
    if (std::strcmp(wanted, name) == 0) {
      if (set <= best) return set;
      throw InputError(std::string("TLEDFACE_INSTRUCTION_SET: got '") + wanted +
                       "', which this processor lacks; unset it to take the best one");
    }
  throw InputError(std::string("TLEDFACE_INSTRUCTION_SET: got '") + wanted +
                   "', allowed are portable, avx2, avx512; unset it to take the best one");
}

const KernelTable& table_of(Precision precision) {
  const bool single = precision == Precision::kSingle;
#if TLEDFACE_X86
  switch (chosen_instruction_set()) {
    case InstructionSet::kAvx512:
      return single ? avx512_float() : avx512_double();
    case InstructionSet::kAvx2:
      return single ? avx2_float() : avx2_double();
    case InstructionSet::kPortable:
      break;
  }
#endif
  return single ? portable_float() : portable_double();
}

class NativeReading final : public Reading {
 public:
  NativeReading(const void* source, std::size_t bytes)
      : bytes_(static_cast<const char*>(source), static_cast<const char*>(source) + bytes) {}
  const void* bytes() override { return bytes_.data(); }

 private:
  std::vector<char> bytes_;
};

class NativeBuffer final : public Buffer {
 public:
  explicit NativeBuffer(std::size_t bytes) : bytes_(bytes), memory_(bytes) {}

  std::size_t bytes() const override { return bytes_; }
  void write(const void* source, std::size_t bytes, std::size_t offset) override {
    check_range(bytes, offset);
    if (bytes) std::memcpy(static_cast<char*>(memory_.data()) + offset, source, bytes);
  }
  void read(void* target, std::size_t bytes, std::size_t offset) const override {
    check_range(bytes, offset);
    if (bytes) std::memcpy(target, static_cast<const char*>(memory_.data()) + offset, bytes);
  }
  std::unique_ptr<Reading> read_later() const override {
    return std::make_unique<NativeReading>(memory_.data(), bytes_);
  }
  void* host_pointer() const override { return memory_.data(); }

 private:
  void check_range(std::size_t bytes, std::size_t offset) const {
    if (offset > bytes_ || bytes > bytes_ - offset)
      throw std::out_of_range("buffer: " + std::to_string(bytes) + " bytes from " +
                              std::to_string(offset) + " are outside its " +
                              std::to_string(bytes_) + " bytes");
  }

  std::size_t bytes_;
  HostMemory memory_;
};

class NativeKernel final : public Kernel {
 public:
  explicit NativeKernel(const KernelEntry& entry)
      : entry_(entry), args_(entry.n_args), bound_(entry.n_args, false) {}

  void set_arg(unsigned index, const Buffer& buffer) override {
    check(index, true);
    if (!buffer.host_pointer())
      throw std::invalid_argument("native kernel: argument " + std::to_string(index) +
                                  " is a buffer of another device");
    args_[index].pointer = buffer.host_pointer();
    bound_[index] = true;
  }
  void set_arg(unsigned index, std::int32_t value) override {
    check(index, false);
    args_[index].integer = value;
    bound_[index] = true;
  }
  void set_local(unsigned, std::size_t) override {
    throw SimulationError(std::string("kernel ") + entry_.name + ": no local memory here");
  }
  std::size_t largest_group() const override { return 0; }
  void enqueue(std::size_t n_items, std::size_t local_size) override {
    for (unsigned index = 0; index < entry_.n_args; ++index)
      if (!bound_[index])
        throw SimulationError(std::string("kernel ") + entry_.name + ": argument " +
                              std::to_string(index) + " is not bound");
    // A work-item is a band of rows where speed matters; many small ones go in chunks.
    const std::size_t grain = n_items > 4096 || local_size > 1 ? 256 : 1;
    const auto launch = [&] {
      parallel_for_chunks(n_items, grain, [&](std::size_t begin, std::size_t end) {
        if (!seconds_ || grain > 1) return entry_.run(args_.data(), begin, end);
        const auto from = std::chrono::steady_clock::now();
        entry_.run(args_.data(), begin, end);
        seconds_[begin] =
            std::chrono::duration<double>(std::chrono::steady_clock::now() - from).count();
      });
    };
    if (active_launch_log())
      logged_launch(entry_.name, launch, [] {});
    else
      launch();
  }
  bool time_items(double* seconds) override {
    seconds_ = seconds;
    return true;
  }

 private:
  void check(unsigned index, bool is_pointer) const {
    if (index >= entry_.n_args || entry_.arg_is_pointer[index] != is_pointer)
      throw SimulationError(std::string("kernel ") + entry_.name + ": argument " +
                            std::to_string(index) + " bound with the wrong kind");
  }
  const KernelEntry& entry_;
  std::vector<KernelArg> args_;
  std::vector<bool> bound_;
  double* seconds_ = nullptr;
};

class NativeProgram final : public Program {
 public:
  explicit NativeProgram(const KernelTable& table) : table_(table) {}
  std::unique_ptr<Kernel> kernel(const std::string& name) override {
    for (unsigned i = 0; i < table_.n_entries; ++i)
      if (name == table_.entries[i].name) return std::make_unique<NativeKernel>(table_.entries[i]);
    throw SimulationError("native device: no kernel '" + name + "'");
  }

 private:
  const KernelTable& table_;
};

// By precision the table of kernels.
using Tables = const KernelTable& (*)(Precision);

class NativeDevice final : public Device {
 public:
  NativeDevice(DeviceInfo info, Tables tables) : info_(std::move(info)), tables_(tables) {}
  const DeviceInfo& info() const override { return info_; }
  bool prefers_vector_rows() const override { return true; }
  bool times_items() const override { return true; }
  int preferred_lanes(Precision precision) const override { return tables_(precision).lanes; }
  std::unique_ptr<Buffer> allocate(std::size_t bytes) override {
    return std::make_unique<NativeBuffer>(bytes);
  }
  std::unique_ptr<Program> build(const ProgramOptions& options) override {
    const KernelTable& table = tables_(options.precision);
    if (!options.vector_rows || options.lanes != table.lanes)
      throw InputError("native device: it has the row kernels with " + std::to_string(table.lanes) +
                       " lanes only; use kernels='rows' (or 'auto')");
    return std::make_unique<NativeProgram>(table);
  }
  void finish() override {}

 private:
  DeviceInfo info_;
  Tables tables_;
};

}  // namespace

std::shared_ptr<Device> make_counting_device() {
  DeviceInfo info = native_device_info();
  info.has_double = false;
  return std::make_shared<NativeDevice>(
      info, +[](Precision) -> const KernelTable& { return counted_float(); });
}

}  // namespace native

DeviceInfo native_device_info() {
  DeviceInfo info;
  info.id = "native";
  info.kind = "native";
  info.platform = native::table_of(Precision::kSingle).instruction_set;
  info.name = "native kernels (" + info.platform + ", " + std::to_string(thread_count()) +
              (thread_count() == 1 ? " thread)" : " threads)");
  info.works = true;
  info.has_double = true;
  info.compute_units = static_cast<unsigned>(thread_count());
  info.memory_bytes = static_cast<std::size_t>(sysconf(_SC_PHYS_PAGES)) *
                      static_cast<std::size_t>(sysconf(_SC_PAGE_SIZE));
  return info;
}

std::shared_ptr<Device> make_native_device() {
  return std::make_shared<native::NativeDevice>(native_device_info(), &native::table_of);
}

}  // namespace tledface
