// What the objects of an OpenCL device share: the context of its cl_device_id, with the programs
// built in it, and its in-order queue.
#pragma once
#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "backend/device.hpp"
#include "backend/opencl/cl_api.hpp"

namespace tledface {

template <typename T>
T query_value(const cl::Api& api, cl::DeviceId device, cl::Enum what) {
  T value = 0;
  if (api.GetDeviceInfo(device, what, sizeof value, &value, nullptr) != cl::kSuccess) return 0;
  return value;
}

// One line; empty where the driver gives none.
std::string device_text(const cl::Api& api, cl::DeviceId device, cl::Enum what);
std::string platform_text(const cl::Api& api, cl::Platform platform, cl::Enum what);

struct OpenClContext {
  // One of each cl_device_id for the life of the process. Throws SimulationError where the driver
  // refuses it.
  static OpenClContext& of(const cl::Api& api, cl::DeviceId device);
  OpenClContext(const cl::Api& api, cl::DeviceId device);

  cl::ProgramId program(const std::string& source, const std::string& build_options,
                        const std::string& device_name);

  const cl::Api& api;
  cl::DeviceId device;
  cl::Context handle = nullptr;
  // Where the driver offers cl_khr_command_buffer for queues like ours.
  std::optional<cl::CommandBufferApi> command_buffers;

 private:
  std::string build_log(cl::ProgramId program_id) const;

  std::mutex mutex_;
  // By full text, which holds the options in its prologue: a changed kernel file is a new program.
  std::map<std::string, cl::ProgramId> programs_;
};

// Device memory and host memory beside it, for a copy that is on its way to the host.
struct OpenClStage {
  std::size_t bytes = 0;
  cl::Memory on_device = nullptr, pinned = nullptr;
  void* on_host = nullptr;  // of `pinned`, or of `pageable` where there was none to be had
  std::vector<std::uint8_t> pageable;
};

// Buffers and kernels share it with their device, so that it may go before them.
struct OpenClQueue {
  OpenClQueue(OpenClContext& context, DeviceInfo info);
  ~OpenClQueue();
  OpenClQueue(const OpenClQueue&) = delete;
  OpenClQueue& operator=(const OpenClQueue&) = delete;

  std::string name() const { return "device '" + info.id + "'"; }
  // Throws SimulationError unless it is CL_SUCCESS.
  void check(cl::Int status, const std::string& call) const;

  // A second queue, for copies that the steps need not wait for.
  cl::Queue transfers();
  // Stages are kept when they are given back: a run takes the same few over and over.
  OpenClStage take_stage(std::size_t bytes);
  void give_back(OpenClStage stage);

  const cl::Api& api;
  OpenClContext& context;
  DeviceInfo info;
  cl::Queue handle = nullptr;
  // While launches are recorded: by which thread (others, of simulators that share the device, go
  // on launching), where they go instead of the queue, their kernels, and what the driver said.
  std::mutex recording_mutex;
  std::atomic<std::thread::id> recorder{std::thread::id()};
  cl::CommandBuffer recording = nullptr;
  std::vector<cl::KernelId> recorded;
  cl::Int recording_status = cl::kSuccess;

 private:
  void release(OpenClStage& stage);

  std::mutex mutex_;  // readings end in other threads than they begin in
  cl::Queue transfers_ = nullptr;
  std::vector<OpenClStage> spare_;
};

}  // namespace tledface
