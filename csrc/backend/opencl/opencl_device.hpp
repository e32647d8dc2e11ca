// OpenCL executor. Devices on the same cl_device_id share one context and its built programs for
// the life of the process; each has its own in-order queue.
#pragma once
#include <memory>
#include <string>

#include "backend/device.hpp"
#include "backend/opencl/cl_api.hpp"

namespace tledface {

struct OpenClQueue;

class OpenClDevice final : public Device {
 public:
  // Throws SimulationError where the driver refuses a context or a queue.
  OpenClDevice(const cl::Api& api, cl::DeviceId handle, DeviceInfo info);

  const DeviceInfo& info() const override;
  bool prefers_vector_rows() const override;
  int preferred_lanes(Precision precision) const override;
  std::unique_ptr<Buffer> allocate(std::size_t bytes) override;
  // Builds options.file of the kernel folder.
  std::unique_ptr<Program> build(const ProgramOptions& options) override;
  std::unique_ptr<Recording> record(const std::function<void()>& launches) override;
  void flush() override;
  void finish() override;

  // Whether the driver says that it has command buffers; DeviceInfo says whether they are right.
  bool offers_command_buffers() const;

  // Builds `source` as it is; SimulationError with the first errors of the compiler's log.
  std::unique_ptr<Program> build_source(const std::string& source, const ProgramOptions& options);

  // For sharing with other OpenCL code (pyopencl's from_int_ptr); they live as long as the device,
  // who takes them over must retain them.
  cl::Context context_handle() const;
  cl::Queue queue_handle() const;

 private:
  std::shared_ptr<OpenClQueue> queue_;
};

// What the driver says about a device; `works` stays false until it is probed.
DeviceInfo describe_opencl_device(const cl::Api& api, cl::Platform platform, cl::DeviceId handle);

}  // namespace tledface
