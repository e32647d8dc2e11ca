#include "backend/opencl/opencl_kernel.hpp"

#include <cstring>
#include <mutex>
#include <stdexcept>
#include <thread>
#include <utility>

#include "backend/launch_log.hpp"

namespace tledface {
namespace {

template <class T>
KernelArgument argument_of(const T& value) {
  KernelArgument argument;
  static_assert(sizeof value <= sizeof argument.value);
  argument.size = sizeof value;
  std::memcpy(argument.value.data(), &value, sizeof value);
  return argument;
}

cl::Int set_in(const cl::Api& api, cl::KernelId kernel, unsigned index,
               const KernelArgument& argument) {
  return api.SetKernelArg(kernel, index, argument.size,
                          argument.is_local ? nullptr : argument.value.data());
}

class OpenClRecording final : public Recording {
 public:
  OpenClRecording(std::shared_ptr<OpenClQueue> queue, cl::CommandBuffer handle)
      : queue_(std::move(queue)), api_(*queue_->context.command_buffers), handle_(handle) {}
  ~OpenClRecording() override {
    queue_->api.Finish(queue_->handle);
    if (last_) queue_->api.ReleaseEvent(last_);
    api_.ReleaseCommandBufferKHR(handle_);
    for (const cl::KernelId kernel : kernels) queue_->api.ReleaseKernel(kernel);
  }
  OpenClRecording(const OpenClRecording&) = delete;
  OpenClRecording& operator=(const OpenClRecording&) = delete;

  void replay() override {
    // Where the driver lacks simultaneous use, one that is still running may not be enqueued again.
    if (last_) {
      queue_->check(queue_->api.WaitForEvents(1, &last_), "clWaitForEvents");
      queue_->api.ReleaseEvent(last_);
      last_ = nullptr;
    }
    queue_->check(api_.EnqueueCommandBufferKHR(0, nullptr, handle_, 0, nullptr,
                                               api_.simultaneous ? nullptr : &last_),
                  "clEnqueueCommandBufferKHR");
  }

  std::vector<cl::KernelId> kernels;  // of its launches

 private:
  std::shared_ptr<OpenClQueue> queue_;
  const cl::CommandBufferApi& api_;
  cl::CommandBuffer handle_;
  cl::Event last_ = nullptr;
};

}  // namespace

OpenClKernel::OpenClKernel(std::shared_ptr<OpenClQueue> queue, cl::ProgramId program,
                           std::string name)
    : queue_(std::move(queue)), program_(program), name_(std::move(name)) {
  cl::Int status = cl::kSuccess;
  handle_ = queue_->api.CreateKernel(program, name_.c_str(), &status);
  queue_->check(status, "clCreateKernel " + name_);
}

OpenClKernel::~OpenClKernel() { queue_->api.ReleaseKernel(handle_); }

void OpenClKernel::set_arg(unsigned index, const Buffer& buffer) {
  const auto memory = static_cast<cl::Memory>(buffer.opencl_handle());
  if (!memory)
    throw std::invalid_argument("kernel " + name_ + " argument " + std::to_string(index) +
                                ": the buffer belongs to another device");
  set(index, argument_of(memory));
}

void OpenClKernel::set_arg(unsigned index, std::int32_t value) { set(index, argument_of(value)); }

void OpenClKernel::set_local(unsigned index, std::size_t bytes) { set(index, {bytes, true, {}}); }

std::size_t OpenClKernel::largest_group() const {
  std::size_t size = 0;
  queue_->check(
      queue_->api.GetKernelWorkGroupInfo(handle_, queue_->context.device, cl::kKernelWorkGroupSize,
                                         sizeof size, &size, nullptr),
      "clGetKernelWorkGroupInfo " + name_);
  return size;
}

void OpenClKernel::enqueue(std::size_t n_items, std::size_t local_size) {
  if (n_items == 0) return;
  if (local_size > 0) n_items = (n_items + local_size - 1) / local_size * local_size;
  const std::size_t* const local = local_size > 0 ? &local_size : nullptr;
  if (queue_->recorder == std::this_thread::get_id()) {
    if (queue_->recording_status == cl::kSuccess) queue_->recording_status = record(n_items, local);
    return;
  }
  cl::Int status = cl::kSuccess;
  const auto launch = [&] {
    status = queue_->api.EnqueueNDRangeKernel(queue_->handle, handle_, 1, nullptr, &n_items, local,
                                              0, nullptr, nullptr);
  };
  if (active_launch_log())
    logged_launch(name_, launch, [&] { queue_->api.Finish(queue_->handle); });
  else
    launch();
  if (status != cl::kSuccess)
    queue_->check(status, "clEnqueueNDRangeKernel " + name_ + " of " + std::to_string(n_items) +
                              " items in groups of " + std::to_string(local_size));
}

void OpenClKernel::set(unsigned index, const KernelArgument& argument) {
  const cl::Int status = set_in(queue_->api, handle_, index, argument);
  if (status != cl::kSuccess)
    queue_->check(status, "clSetKernelArg " + name_ + " argument " + std::to_string(index));
  if (index >= arguments_.size()) arguments_.resize(index + 1);
  arguments_[index] = argument;
}

// The extension takes arguments when a launch is recorded; PoCL 3.1 takes those that the kernel has
// when it is replayed, so that each launch needs a kernel whose arguments stay.
cl::Int OpenClKernel::record(std::size_t n_items, const std::size_t* local) const {
  cl::Int status = cl::kSuccess;
  const cl::KernelId own = queue_->api.CreateKernel(program_, name_.c_str(), &status);
  if (status != cl::kSuccess) return status;
  queue_->recorded.push_back(own);
  for (unsigned index = 0; index < arguments_.size() && status == cl::kSuccess; ++index)
    status = set_in(queue_->api, own, index, arguments_[index]);
  if (status != cl::kSuccess) return status;
  return queue_->context.command_buffers->CommandNDRangeKernelKHR(
      queue_->recording, nullptr, nullptr, own, 1, nullptr, &n_items, local, 0, nullptr, nullptr,
      nullptr);
}

std::unique_ptr<Recording> record_launches(std::shared_ptr<OpenClQueue> queue,
                                           const std::function<void()>& launches) {
  if (!queue->context.command_buffers) return nullptr;
  const cl::CommandBufferApi& api = *queue->context.command_buffers;
  const std::uint64_t properties[] = {cl::kCommandBufferFlags, cl::kCommandBufferSimultaneousUse,
                                      0};
  cl::Int status = cl::kSuccess;
  const cl::CommandBuffer handle = api.CreateCommandBufferKHR(
      1, &queue->handle, api.simultaneous ? properties : nullptr, &status);
  if (status != cl::kSuccess) return nullptr;
  auto recording = std::make_unique<OpenClRecording>(queue, handle);
  struct End {
    OpenClQueue& queue;
    OpenClRecording& recording;
    ~End() {
      queue.recorder = std::thread::id();
      queue.recording = nullptr;
      recording.kernels = std::move(queue.recorded);
      queue.recorded.clear();
    }
  };
  cl::Int refused = cl::kSuccess;
  {
    const std::lock_guard<std::mutex> one_at_a_time(queue->recording_mutex);
    const End end{*queue, *recording};
    queue->recording = handle;
    queue->recording_status = cl::kSuccess;
    queue->recorder = std::this_thread::get_id();
    launches();
    refused = queue->recording_status;
  }
  if (refused != cl::kSuccess) return nullptr;
  if (api.FinalizeCommandBufferKHR(handle) != cl::kSuccess) return nullptr;
  return recording;
}

}  // namespace tledface
