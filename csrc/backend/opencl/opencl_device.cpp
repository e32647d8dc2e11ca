#include "backend/opencl/opencl_device.hpp"

#include <algorithm>
#include <cstdio>
#include <deque>
#include <map>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "backend/launch_log.hpp"
#include "backend/opencl/loader.hpp"
#include "backend/opencl/sources.hpp"
#include "core/error.hpp"

namespace tledface {
namespace {

constexpr const char* kBuildOptions =
    "-cl-std=CL1.2 -cl-mad-enable -cl-no-signed-zeros -cl-denorms-are-zero";
// Buffers end on a full vector row and a cache line, so that whole rows can be filled.
constexpr std::size_t kBufferGranularity = 128;
// Copies of what waits to be written to a buffer: how far the host runs ahead of the device.
constexpr std::size_t kWritesAhead = 2;

std::string size_text(std::size_t bytes) {
  const char* const units[] = {"B", "KiB", "MiB", "GiB", "TiB"};
  double value = static_cast<double>(bytes);
  int unit = 0;
  for (; value >= 1024 && unit < 4; ++unit) value /= 1024;
  char text[32];
  std::snprintf(text, sizeof text, unit == 0 ? "%.0f %s" : "%.1f %s", value, units[unit]);
  return text;
}

std::string one_line(const std::string& text) {
  std::string line;
  for (const char c : text) {
    const bool blank = c == '\0' || c == ' ' || c == '\n' || c == '\r' || c == '\t';
    if (!blank)
      line += c;
    else if (!line.empty() && line.back() != ' ')
      line += ' ';
  }
  while (!line.empty() && line.back() == ' ') line.pop_back();
  return line;
}

template <typename Query, typename Object>
std::string query_text(Query query, Object object, cl::Enum what) {
  std::size_t size = 0;
  if (query(object, what, 0, nullptr, &size) != cl::kSuccess || size == 0) return {};
  std::string text(size, '\0');
  if (query(object, what, size, text.data(), nullptr) != cl::kSuccess) return {};
  return one_line(text);
}

template <typename T>
T query_value(const cl::Api& api, cl::DeviceId device, cl::Enum what) {
  T value = 0;
  if (api.GetDeviceInfo(device, what, sizeof value, &value, nullptr) != cl::kSuccess) return 0;
  return value;
}

bool host_has_avx512() {
#if defined(__x86_64__)
  return __builtin_cpu_supports("avx512f");
#else
  return false;
#endif
}

// The compiler's errors, or the log's first lines where it names none; at most four, in one line.
std::string first_errors(const std::string& log) {
  std::string errors, head;
  int n_errors = 0, n_head = 0;
  for (std::size_t start = 0; start < log.size();) {
    const auto end = std::min(log.find('\n', start), log.size());
    const std::string line = one_line(log.substr(start, end - start));
    start = end + 1;
    if (line.empty()) continue;
    if (line.find("error") != std::string::npos && n_errors++ < 4)
      errors += (errors.empty() ? "" : " | ") + line;
    if (n_head++ < 4) head += (head.empty() ? "" : " | ") + line;
  }
  if (!errors.empty()) return errors;
  return head.empty() ? "the compiler left no log" : head;
}

}  // namespace

// Context of one cl_device_id with the programs built in it.
struct OpenClContext {
  OpenClContext(const cl::Api& api, cl::DeviceId device) : api(api), device(device) {
    cl::Int status = cl::kSuccess;
    handle = api.CreateContext(nullptr, 1, &device, nullptr, nullptr, &status);
    if (status != cl::kSuccess)
      throw SimulationError("clCreateContext: " + opencl_error_name(status));
  }

  // Never destroyed: see loader().
  static OpenClContext& of(const cl::Api& api, cl::DeviceId device) {
    static std::mutex mutex;
    static auto* contexts = new std::map<cl::DeviceId, std::unique_ptr<OpenClContext>>;
    std::lock_guard<std::mutex> lock(mutex);
    auto& context = (*contexts)[device];
    if (!context) context = std::make_unique<OpenClContext>(api, device);
    return *context;
  }

  cl::ProgramId program(const std::string& source, const std::string& build_options,
                        const std::string& device_name) {
    std::lock_guard<std::mutex> lock(mutex);
    const auto found = programs.find(source);
    if (found != programs.end()) return found->second;
    cl::Int status = cl::kSuccess;
    const char* text = source.c_str();
    const std::size_t length = source.size();
    cl::ProgramId built = api.CreateProgramWithSource(handle, 1, &text, &length, &status);
    if (status != cl::kSuccess)
      throw SimulationError(device_name +
                            ": clCreateProgramWithSource: " + opencl_error_name(status));
    status = api.BuildProgram(built, 1, &device, build_options.c_str(), nullptr, nullptr);
    if (status != cl::kSuccess) {
      const std::string log = build_log(built);
      api.ReleaseProgram(built);
      throw SimulationError(device_name + ": kernels do not compile, " + opencl_error_name(status) +
                            ": " + first_errors(log));
    }
    programs.emplace(source, built);
    return built;
  }

  std::string build_log(cl::ProgramId program_id) const {
    std::size_t size = 0;
    if (api.GetProgramBuildInfo(program_id, device, cl::kProgramBuildLog, 0, nullptr, &size) !=
            cl::kSuccess ||
        size == 0)
      return {};
    std::string log(size, '\0');
    api.GetProgramBuildInfo(program_id, device, cl::kProgramBuildLog, size, log.data(), nullptr);
    return log;
  }

  const cl::Api& api;
  cl::DeviceId device;
  cl::Context handle = nullptr;
  std::mutex mutex;
  // By full text, which holds the options in its prologue: a changed kernel file is a new program.
  std::map<std::string, cl::ProgramId> programs;
};

// What buffers and kernels share with their device, so that it may go before them.
struct OpenClQueue {
  OpenClQueue(OpenClContext& context, DeviceInfo info)
      : api(context.api), context(context), info(std::move(info)) {
    cl::Int status = cl::kSuccess;
    handle = api.CreateCommandQueue(context.handle, context.device, 0, &status);
    check(status, "clCreateCommandQueue");
  }
  ~OpenClQueue() {
    api.Finish(handle);
    api.ReleaseCommandQueue(handle);
  }
  OpenClQueue(const OpenClQueue&) = delete;
  OpenClQueue& operator=(const OpenClQueue&) = delete;

  std::string name() const { return "device '" + info.id + "'"; }

  void check(cl::Int status, const std::string& call) const {
    if (status != cl::kSuccess)
      throw SimulationError(name() + ": " + call + ": " + opencl_error_name(status));
  }

  const cl::Api& api;
  OpenClContext& context;
  DeviceInfo info;
  cl::Queue handle = nullptr;
};

namespace {

class OpenClBuffer final : public Buffer {
 public:
  OpenClBuffer(std::shared_ptr<OpenClQueue> queue, std::size_t bytes)
      : queue_(std::move(queue)), bytes_(bytes) {
    const auto& api = queue_->api;
    const std::size_t padded = (std::max<std::size_t>(bytes, 1) + kBufferGranularity - 1) /
                               kBufferGranularity * kBufferGranularity;
    const auto largest =
        query_value<std::uint64_t>(api, queue_->context.device, cl::kDeviceMaxMemoryAllocation);
    // Some drivers accept more than they have and fail, or swap, when it is first used.
    if (padded < bytes || padded > largest) refuse(cl::kInvalidBufferSize, largest);
    cl::Int status = cl::kSuccess;
    handle_ =
        api.CreateBuffer(queue_->context.handle, cl::kMemoryReadWrite, padded, nullptr, &status);
    if (status != cl::kSuccess) refuse(status, largest);
    const std::uint32_t zero = 0;
    status = api.EnqueueFillBuffer(queue_->handle, handle_, &zero, sizeof zero, 0, padded, 0,
                                   nullptr, nullptr);
    if (status == cl::kSuccess) status = api.Finish(queue_->handle);
    if (status != cl::kSuccess) {
      api.ReleaseMemObject(handle_);
      refuse(status, largest);
    }
  }
  ~OpenClBuffer() override {
    while (!waiting_.empty()) let_go_first();
    queue_->api.ReleaseMemObject(handle_);
  }
  OpenClBuffer(const OpenClBuffer&) = delete;
  OpenClBuffer& operator=(const OpenClBuffer&) = delete;

  std::size_t bytes() const override { return bytes_; }

  void write(const void* source, std::size_t bytes, std::size_t offset) override {
    if (!check_range(bytes, offset)) return;
    queue_->check(queue_->api.EnqueueWriteBuffer(queue_->handle, handle_, cl::kTrue, offset, bytes,
                                                 source, 0, nullptr, nullptr),
                  "clEnqueueWriteBuffer");
  }

  void read(void* target, std::size_t bytes, std::size_t offset) const override {
    if (!check_range(bytes, offset)) return;
    queue_->check(queue_->api.EnqueueReadBuffer(queue_->handle, handle_, cl::kTrue, offset, bytes,
                                                target, 0, nullptr, nullptr),
                  "clEnqueueReadBuffer");
  }

  void write_later(const void* source, std::size_t bytes) override {
    if (!check_range(bytes, 0)) return;
    while (waiting_.size() >= kWritesAhead) queue_->check(let_go_first(), "clWaitForEvents");
    const auto* begin = static_cast<const std::uint8_t*>(source);
    waiting_.push_back({std::vector<std::uint8_t>(begin, begin + bytes), nullptr});
    const cl::Int status = queue_->api.EnqueueWriteBuffer(queue_->handle, handle_, cl::kFalse, 0,
                                                          bytes, waiting_.back().bytes.data(), 0,
                                                          nullptr, &waiting_.back().done);
    if (status != cl::kSuccess) waiting_.pop_back();
    queue_->check(status, "clEnqueueWriteBuffer");
  }

  void* opencl_handle() const override { return handle_; }

 private:
  struct Waiting {
    std::vector<std::uint8_t> bytes;
    cl::Event done;
  };

  // Waits for the first that is being written.
  cl::Int let_go_first() {
    const cl::Int status = queue_->api.WaitForEvents(1, &waiting_.front().done);
    queue_->api.ReleaseEvent(waiting_.front().done);
    waiting_.pop_front();
    return status;
  }

  // False where there is nothing to copy; OpenCL has no empty transfer.
  bool check_range(std::size_t bytes, std::size_t offset) const {
    if (offset > bytes_ || bytes > bytes_ - offset)
      throw std::out_of_range("buffer of " + std::to_string(bytes_) + " bytes: cannot copy " +
                              std::to_string(bytes) + " at offset " + std::to_string(offset));
    return bytes > 0;
  }

  [[noreturn]] void refuse(cl::Int status, std::size_t largest) const {
    const bool no_room = status == cl::kMemoryAllocationFailure || status == cl::kOutOfResources ||
                         status == cl::kOutOfHostMemory || status == cl::kInvalidBufferSize;
    if (!no_room) queue_->check(status, "clCreateBuffer");
    throw InputError(queue_->name() + ": no room for a buffer of " + size_text(bytes_) +
                     "; the device has " + size_text(queue_->info.memory_bytes) + ", at most " +
                     size_text(largest) +
                     " in one piece; use larger voxels, a smaller region or another device");
  }

  std::shared_ptr<OpenClQueue> queue_;
  std::size_t bytes_;
  cl::Memory handle_ = nullptr;
  std::deque<Waiting> waiting_;
};

class OpenClKernel final : public Kernel {
 public:
  OpenClKernel(std::shared_ptr<OpenClQueue> queue, cl::ProgramId program, std::string name)
      : queue_(std::move(queue)), name_(std::move(name)) {
    cl::Int status = cl::kSuccess;
    handle_ = queue_->api.CreateKernel(program, name_.c_str(), &status);
    queue_->check(status, "clCreateKernel " + name_);
  }
  ~OpenClKernel() override { queue_->api.ReleaseKernel(handle_); }
  OpenClKernel(const OpenClKernel&) = delete;
  OpenClKernel& operator=(const OpenClKernel&) = delete;

  void set_arg(unsigned index, const Buffer& buffer) override {
    const auto memory = static_cast<cl::Memory>(buffer.opencl_handle());
    if (!memory)
      throw std::invalid_argument("kernel " + name_ + " argument " + std::to_string(index) +
                                  ": the buffer belongs to another device");
    set(index, sizeof memory, &memory);
  }

  void set_arg(unsigned index, std::int32_t value) override { set(index, sizeof value, &value); }

  void set_local(unsigned index, std::size_t bytes) override { set(index, bytes, nullptr); }

  std::size_t largest_group() const override {
    std::size_t size = 0;
    queue_->check(
        queue_->api.GetKernelWorkGroupInfo(handle_, queue_->context.device,
                                           cl::kKernelWorkGroupSize, sizeof size, &size, nullptr),
        "clGetKernelWorkGroupInfo " + name_);
    return size;
  }

  void enqueue(std::size_t n_items, std::size_t local_size) override {
    if (n_items == 0) return;
    if (local_size > 0) n_items = (n_items + local_size - 1) / local_size * local_size;
    cl::Int status = cl::kSuccess;
    const auto launch = [&] {
      status = queue_->api.EnqueueNDRangeKernel(queue_->handle, handle_, 1, nullptr, &n_items,
                                                local_size > 0 ? &local_size : nullptr, 0, nullptr,
                                                nullptr);
    };
    if (active_launch_log())
      logged_launch(name_, launch, [&] { queue_->api.Finish(queue_->handle); });
    else
      launch();
    if (status != cl::kSuccess)
      queue_->check(status, "clEnqueueNDRangeKernel " + name_ + " of " + std::to_string(n_items) +
                                " items in groups of " + std::to_string(local_size));
  }

 private:
  void set(unsigned index, std::size_t size, const void* value) {
    const cl::Int status = queue_->api.SetKernelArg(handle_, index, size, value);
    if (status != cl::kSuccess)
      queue_->check(status, "clSetKernelArg " + name_ + " argument " + std::to_string(index));
  }

  std::shared_ptr<OpenClQueue> queue_;
  std::string name_;
  cl::KernelId handle_ = nullptr;
};

class OpenClProgram final : public Program {
 public:
  OpenClProgram(std::shared_ptr<OpenClQueue> queue, cl::ProgramId handle)
      : queue_(std::move(queue)), handle_(handle) {}
  std::unique_ptr<Kernel> kernel(const std::string& name) override {
    return std::make_unique<OpenClKernel>(queue_, handle_, name);
  }

 private:
  std::shared_ptr<OpenClQueue> queue_;
  cl::ProgramId handle_;
};

}  // namespace

OpenClDevice::OpenClDevice(const cl::Api& api, cl::DeviceId handle, DeviceInfo info)
    : queue_(std::make_shared<OpenClQueue>(OpenClContext::of(api, handle), std::move(info))) {}

const DeviceInfo& OpenClDevice::info() const { return queue_->info; }

bool OpenClDevice::prefers_vector_rows() const { return queue_->info.kind == "cpu"; }

int OpenClDevice::preferred_lanes(Precision precision) const {
  if (!prefers_vector_rows()) return 16;
  const auto native =
      query_value<cl::UInt>(queue_->api, queue_->context.device, cl::kDeviceNativeVectorWidthFloat);
  const int lanes = native >= 16 || host_has_avx512() ? 16 : 8;
  return precision == Precision::kDouble ? lanes / 2 : lanes;
}

std::unique_ptr<Buffer> OpenClDevice::allocate(std::size_t bytes) {
  return std::make_unique<OpenClBuffer>(queue_, bytes);
}

std::unique_ptr<Program> OpenClDevice::build(const ProgramOptions& options) {
  return build_source(kernel_source(options.file, options), options);
}

std::unique_ptr<Program> OpenClDevice::build_source(const std::string& source,
                                                    const ProgramOptions& options) {
  if (options.precision == Precision::kDouble && !info().has_double)
    throw InputError(queue_->name() + " (" + info().name +
                     "): has no double precision; use precision='single' or device='native'");
  std::string build_options = kBuildOptions;
  if (options.registers > 0 && info().limits_registers)
    build_options += " -cl-nv-maxrregcount=" + std::to_string(options.registers);
  return std::make_unique<OpenClProgram>(
      queue_, queue_->context.program(source, build_options, queue_->name()));
}

void OpenClDevice::flush() { queue_->check(queue_->api.Flush(queue_->handle), "clFlush"); }

void OpenClDevice::finish() { queue_->check(queue_->api.Finish(queue_->handle), "clFinish"); }

cl::Context OpenClDevice::context_handle() const { return queue_->context.handle; }

cl::Queue OpenClDevice::queue_handle() const { return queue_->handle; }

DeviceInfo describe_opencl_device(const cl::Api& api, cl::Platform platform, cl::DeviceId handle) {
  DeviceInfo info;
  info.name = query_text(api.GetDeviceInfo, handle, cl::kDeviceName);
  info.platform = query_text(api.GetPlatformInfo, platform, cl::kPlatformName) + ", " +
                  query_text(api.GetPlatformInfo, platform, cl::kPlatformVersion);
  info.driver = query_text(api.GetDeviceInfo, handle, cl::kDriverVersion);
  const auto type = query_value<cl::Bitfield>(api, handle, cl::kDeviceType);
  info.kind = type & cl::kDeviceTypeGpu ? "gpu" : type & cl::kDeviceTypeCpu ? "cpu" : "accelerator";
  info.has_double = query_value<cl::Bitfield>(api, handle, cl::kDeviceDoubleConfig) != 0;
  info.compute_units = query_value<cl::UInt>(api, handle, cl::kDeviceMaxComputeUnits);
  info.memory_bytes = query_value<std::uint64_t>(api, handle, cl::kDeviceGlobalMemorySize);
  info.limits_registers =
      query_text(api.GetDeviceInfo, handle, cl::kDeviceExtensions).find("cl_nv_compiler_options") !=
      std::string::npos;
  info.local_bytes = query_value<std::uint64_t>(api, handle, cl::kDeviceLocalMemorySize);
  if (!query_value<cl::Bool>(api, handle, cl::kDeviceAvailable))
    info.reason = "the driver says it is not available";
  else if (!query_value<cl::Bool>(api, handle, cl::kDeviceCompilerAvailable))
    info.reason = "the driver has no kernel compiler";
  return info;
}

}  // namespace tledface
