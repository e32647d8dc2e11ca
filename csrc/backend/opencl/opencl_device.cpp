#include "backend/opencl/opencl_device.hpp"

#include <utility>

#include "backend/opencl/opencl_buffer.hpp"
#include "backend/opencl/opencl_kernel.hpp"
#include "backend/opencl/sources.hpp"
#include "core/error.hpp"

namespace tledface {
namespace {

constexpr const char* kBuildOptions =
    "-cl-std=CL1.2 -cl-mad-enable -cl-no-signed-zeros -cl-denorms-are-zero";

bool host_has_avx512() {
#if defined(__x86_64__)
  return __builtin_cpu_supports("avx512f");
#else
  return false;
#endif
}

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

std::unique_ptr<Recording> OpenClDevice::record(const std::function<void()>& launches) {
  return info().command_buffers ? record_launches(queue_, launches) : nullptr;
}

bool OpenClDevice::offers_command_buffers() const {
  return queue_->context.command_buffers.has_value();
}

void OpenClDevice::flush() { queue_->check(queue_->api.Flush(queue_->handle), "clFlush"); }

void OpenClDevice::finish() { queue_->check(queue_->api.Finish(queue_->handle), "clFinish"); }

cl::Context OpenClDevice::context_handle() const { return queue_->context.handle; }

cl::Queue OpenClDevice::queue_handle() const { return queue_->handle; }

DeviceInfo describe_opencl_device(const cl::Api& api, cl::Platform platform, cl::DeviceId handle) {
  DeviceInfo info;
  info.name = device_text(api, handle, cl::kDeviceName);
  info.platform = platform_text(api, platform, cl::kPlatformName) + ", " +
                  platform_text(api, platform, cl::kPlatformVersion);
  info.driver = device_text(api, handle, cl::kDriverVersion);
  const auto type = query_value<cl::Bitfield>(api, handle, cl::kDeviceType);
  info.kind = type & cl::kDeviceTypeGpu ? "gpu" : type & cl::kDeviceTypeCpu ? "cpu" : "accelerator";
  info.has_double = query_value<cl::Bitfield>(api, handle, cl::kDeviceDoubleConfig) != 0;
  info.compute_units = query_value<cl::UInt>(api, handle, cl::kDeviceMaxComputeUnits);
  info.memory_bytes = query_value<std::uint64_t>(api, handle, cl::kDeviceGlobalMemorySize);
  info.limits_registers =
      device_text(api, handle, cl::kDeviceExtensions).find("cl_nv_compiler_options") !=
      std::string::npos;
  info.local_bytes = query_value<std::uint64_t>(api, handle, cl::kDeviceLocalMemorySize);
  if (!query_value<cl::Bool>(api, handle, cl::kDeviceAvailable))
    info.reason = "the driver says it is not available";
  else if (!query_value<cl::Bool>(api, handle, cl::kDeviceCompilerAvailable))
    info.reason = "the driver has no kernel compiler";
  return info;
}

}  // namespace tledface
