// One interface over the executors: `native` (CPU kernels compiled ahead of time) and `opencl`
// (any OpenCL device). The simulator knows only this header.
#pragma once
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace tledface {

enum class Precision { kSingle, kDouble };

inline std::size_t real_size(Precision precision) {
  return precision == Precision::kSingle ? sizeof(float) : sizeof(double);
}

struct DeviceInfo {
  std::string id;        // what `device=` takes: "native", "opencl:0", …
  std::string name;      // as the driver says it
  std::string kind;      // "native", "cpu", "gpu" or "accelerator"
  std::string platform;  // OpenCL platform name and version; the instruction set for native
  std::string driver;    // driver version
  bool works = false;    // a probe kernel ran and gave the right answer
  std::string reason;    // why not, one line; empty where it works
  bool has_double = false;
  unsigned compute_units = 1;
  std::size_t memory_bytes = 0;
  bool limits_registers = false;  // ProgramOptions::registers is heeded
  std::size_t local_bytes = 0;    // of a work-group; 0: there are none
  bool command_buffers = false;   // launches can be recorded: a trial gave the right bits
};

// What a buffer held at one moment, on its way to the host.
class Reading {
 public:
  virtual ~Reading() = default;
  // Waits until it is there; in any thread. The bytes stay as long as this does.
  virtual const void* bytes() = 0;
};

// Device memory. Offsets and sizes in bytes; all calls are ordered with the launches of its device.
class Buffer {
 public:
  virtual ~Buffer() = default;
  virtual std::size_t bytes() const = 0;
  virtual void write(const void* source, std::size_t bytes,
                     std::size_t offset = 0) = 0;  // blocking
  // The same without waiting for what was enqueued before; the source is copied first.
  virtual void write_later(const void* source, std::size_t bytes) { write(source, bytes); }
  virtual void read(void* target, std::size_t bytes, std::size_t offset = 0) const = 0;  // blocking
  // All of it, as it is after what was enqueued before; what is enqueued next changes nothing in
  // the reading and need not wait for it. Where nothing is asynchronous it is copied at once.
  virtual std::unique_ptr<Reading> read_later() const = 0;
  // The memory itself where the host can use it as it is (native), else null.
  virtual void* host_pointer() const { return nullptr; }
  // cl_mem where the device is an OpenCL one, else null.
  virtual void* opencl_handle() const { return nullptr; }
};

// A kernel with its arguments bound; bind again to change one. Arguments are buffers and 32-bit
// integers only (and local memory): real numbers travel in buffers, so that no argument changes
// size with precision.
class Kernel {
 public:
  virtual ~Kernel() = default;
  virtual void set_arg(unsigned index, const Buffer& buffer) = 0;
  virtual void set_arg(unsigned index, std::int32_t value) = 0;
  // Local memory of a work-group; only where DeviceInfo::local_bytes says that there is some.
  virtual void set_local(unsigned index, std::size_t bytes) = 0;
  // Work-items of the largest group that it can run in; 0: it has none.
  virtual std::size_t largest_group() const = 0;
  // Enqueues `n_items` work-items in order; returns at once where the device is asynchronous.
  // local_size 0 leaves the work-group size to the device; else n_items is rounded up to a multiple
  // of it (kernels check their range themselves).
  virtual void enqueue(std::size_t n_items, std::size_t local_size = 0) = 0;
  // Where each launch of up to 4096 items in groups of one, from now on, leaves how many seconds
  // every item took; it must outlive the launches. False where that is not known when enqueue() is
  // back (Device::times_items).
  virtual bool time_items(double* seconds) {
    static_cast<void>(seconds);
    return false;
  }
};

// What a program is compiled for. `lanes`: nodes of a block, the width of the vector rows.
// `vector_rows`: kernels use vectors of `lanes` reals (CPUs) instead of one work-item an element.
struct ProgramOptions {
  Precision precision = Precision::kSingle;
  int lanes = 16;
  bool vector_rows = true;
  // False where no block has law entries, for work-items of one lane.
  bool laws = true;
  // Of a work-item, at most; 0, or where DeviceInfo::limits_registers is false: as compiled.
  int registers = 0;
  std::string file = "program.cl";  // of the kernel folder; native programs have all kernels
};

class Program {
 public:
  virtual ~Program() = default;
  virtual std::unique_ptr<Kernel> kernel(const std::string& name) = 0;
};

// Launches that were recorded once, with their arguments as they were.
class Recording {
 public:
  virtual ~Recording() = default;
  // Enqueues all of them in their order.
  virtual void replay() = 0;
};

class Device {
 public:
  virtual ~Device() = default;
  virtual const DeviceInfo& info() const = 0;
  // True where the fused vector-row kernels are the right ones (CPUs).
  virtual bool prefers_vector_rows() const = 0;
  // Reals a vector row should have here (native: the instruction set's; OpenCL CPU: 8 or 16).
  virtual int preferred_lanes(Precision precision) const = 0;
  // Whether kernels can tell how long each item took (Kernel::time_items).
  virtual bool times_items() const { return false; }
  // Zero-filled memory; throws InputError when there is not enough, saying how much was asked for.
  virtual std::unique_ptr<Buffer> allocate(std::size_t bytes) = 0;
  virtual std::unique_ptr<Program> build(const ProgramOptions& options) = 0;
  // Calls launches() and keeps the kernels that it enqueues instead of running them. Null where
  // that cannot be done (DeviceInfo::command_buffers says where it can), or not with these; nothing
  // has run then.
  virtual std::unique_ptr<Recording> record(const std::function<void()>& launches) {
    static_cast<void>(launches);
    return nullptr;
  }
  virtual void finish() = 0;
  // Makes sure that what was enqueued begins.
  virtual void flush() {}
};

// Native executor; always there.
std::shared_ptr<Device> make_native_device();
DeviceInfo native_device_info();

// OpenCL (csrc/backend/opencl). Every listed device, probed once a process with a real kernel;
// empty when no loader is found.
std::vector<DeviceInfo> opencl_devices();
// Where the OpenCL library came from, or why none was found; one line, for `tledface doctor`.
std::string opencl_loader_report();
// index into opencl_devices(); throws InputError for one that does not exist or does not work.
std::shared_ptr<Device> make_opencl_device(std::size_t index);
// From a cl_device_id (pyopencl.Device.int_ptr) of the loader in this process.
std::shared_ptr<Device> make_opencl_device_from_handle(std::uintptr_t cl_device_id);

// All devices: native first, then OpenCL.
std::vector<DeviceInfo> all_devices();
// "auto" (a working GPU, else native), "native", "opencl" (first that works, GPUs first),
// "opencl:N".
std::shared_ptr<Device> open_device(const std::string& spec);

}  // namespace tledface
