// Kernels of an OpenCL device, and launches of them that are recorded
// (cl_khr_command_buffer) and replayed.
#pragma once
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "backend/opencl/opencl_queue.hpp"

namespace tledface {

// As clSetKernelArg takes it: a cl_mem, a 32-bit integer, or local memory, which has no value.
struct KernelArgument {
  std::size_t size = 0;
  bool is_local = false;
  std::array<std::uint8_t, sizeof(cl::Memory)> value{};
};

class OpenClKernel final : public Kernel {
 public:
  OpenClKernel(std::shared_ptr<OpenClQueue> queue, cl::ProgramId program, std::string name);
  ~OpenClKernel() override;
  OpenClKernel(const OpenClKernel&) = delete;
  OpenClKernel& operator=(const OpenClKernel&) = delete;

  void set_arg(unsigned index, const Buffer& buffer) override;
  void set_arg(unsigned index, std::int32_t value) override;
  void set_local(unsigned index, std::size_t bytes) override;
  std::size_t largest_group() const override;
  void enqueue(std::size_t n_items, std::size_t local_size) override;

 private:
  void set(unsigned index, const KernelArgument& argument);
  // A kernel of its own with the arguments of now goes into the recording.
  cl::Int record(std::size_t n_items, const std::size_t* local) const;

  std::shared_ptr<OpenClQueue> queue_;
  cl::ProgramId program_;
  std::string name_;
  cl::KernelId handle_ = nullptr;
  std::vector<KernelArgument> arguments_;
};

// See Device::record. Null where the driver has no command buffers or refuses what is recorded.
std::unique_ptr<Recording> record_launches(std::shared_ptr<OpenClQueue> queue,
                                           const std::function<void()>& launches);

}  // namespace tledface
