#include "backend/opencl/opencl_buffer.hpp"

#include <algorithm>
#include <cstdio>
#include <stdexcept>
#include <utility>

#include "backend/host_memory.hpp"
#include "core/error.hpp"

namespace tledface {
namespace {

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

class OpenClReading final : public Reading {
 public:
  OpenClReading(std::shared_ptr<OpenClQueue> queue, cl::Memory source, std::size_t bytes)
      : queue_(std::move(queue)), stage_(queue_->take_stage(bytes)) {
    const auto& api = queue_->api;
    // The copy is ordered with the steps; what takes it to the host is not.
    cl::Event copied = nullptr;
    cl::Int status = api.EnqueueCopyBuffer(queue_->handle, source, stage_.on_device, 0, 0, bytes, 0,
                                           nullptr, &copied);
    if (status == cl::kSuccess) {
      status = api.Flush(queue_->handle);
      if (status == cl::kSuccess)
        status = api.EnqueueReadBuffer(queue_->transfers(), stage_.on_device, cl::kFalse, 0, bytes,
                                       stage_.on_host, 1, &copied, &done_);
      api.ReleaseEvent(copied);
    }
    if (status == cl::kSuccess) status = api.Flush(queue_->transfers());
    if (status == cl::kSuccess) return;
    end();
    queue_->check(status, "reading a buffer");
  }
  ~OpenClReading() override { end(); }
  OpenClReading(const OpenClReading&) = delete;
  OpenClReading& operator=(const OpenClReading&) = delete;

  const void* bytes() override {
    queue_->check(queue_->api.WaitForEvents(1, &done_), "clWaitForEvents");
    return stage_.on_host;
  }

 private:
  void end() {
    if (done_) {
      queue_->api.WaitForEvents(1, &done_);
      queue_->api.ReleaseEvent(done_);
    } else {
      queue_->api.Finish(queue_->handle);
    }
    queue_->give_back(std::move(stage_));
  }

  std::shared_ptr<OpenClQueue> queue_;
  OpenClStage stage_;
  cl::Event done_ = nullptr;
};

}  // namespace

OpenClBuffer::OpenClBuffer(std::shared_ptr<OpenClQueue> queue, std::size_t bytes)
    : queue_(std::move(queue)), bytes_(bytes) {
  const auto& api = queue_->api;
  const std::size_t padded = (std::max<std::size_t>(bytes, 1) + kBufferGranularity - 1) /
                             kBufferGranularity * kBufferGranularity;
  const auto largest =
      query_value<std::uint64_t>(api, queue_->context.device, cl::kDeviceMaxMemoryAllocation);
  // Some drivers accept more than they have and fail, or swap, when it is first used.
  if (padded < bytes || padded > largest) refuse(cl::kInvalidBufferSize, largest);
  handle_ = create_in_large_pages(padded);
  if (handle_) return;
  cl::Int status = cl::kSuccess;
  handle_ =
      api.CreateBuffer(queue_->context.handle, cl::kMemoryReadWrite, padded, nullptr, &status);
  if (status != cl::kSuccess) refuse(status, largest);
  const std::uint32_t zero = 0;
  status = api.EnqueueFillBuffer(queue_->handle, handle_, &zero, sizeof zero, 0, padded, 0, nullptr,
                                 nullptr);
  if (status == cl::kSuccess) status = api.Finish(queue_->handle);
  if (status != cl::kSuccess) {
    api.ReleaseMemObject(handle_);
    refuse(status, largest);
  }
}

// The object frees that memory when it goes: commands and others (pyopencl) may keep it longer than
// this does.
cl::Memory OpenClBuffer::create_in_large_pages(std::size_t bytes) const {
  if (queue_->info.kind != "cpu" || bytes < HostMemory::kLargePage) return nullptr;
  const auto& api = queue_->api;
  auto host = std::make_unique<HostMemory>(bytes);
  cl::Int status = cl::kSuccess;
  cl::Memory memory =
      api.CreateBuffer(queue_->context.handle, cl::kMemoryReadWrite | cl::kMemoryUseHostPointer,
                       bytes, host->data(), &status);
  if (status != cl::kSuccess) return nullptr;
  const auto let_go = [](cl::Memory, void* data) { delete static_cast<HostMemory*>(data); };
  if (api.SetMemObjectDestructorCallback(memory, let_go, host.get()) != cl::kSuccess) {
    api.ReleaseMemObject(memory);
    return nullptr;
  }
  host.release();
  return memory;
}

OpenClBuffer::~OpenClBuffer() {
  while (!waiting_.empty()) let_go_first();
  queue_->api.ReleaseMemObject(handle_);
}

void OpenClBuffer::write(const void* source, std::size_t bytes, std::size_t offset) {
  if (!check_range(bytes, offset)) return;
  queue_->check(queue_->api.EnqueueWriteBuffer(queue_->handle, handle_, cl::kTrue, offset, bytes,
                                               source, 0, nullptr, nullptr),
                "clEnqueueWriteBuffer");
}

void OpenClBuffer::read(void* target, std::size_t bytes, std::size_t offset) const {
  if (!check_range(bytes, offset)) return;
  queue_->check(queue_->api.EnqueueReadBuffer(queue_->handle, handle_, cl::kTrue, offset, bytes,
                                              target, 0, nullptr, nullptr),
                "clEnqueueReadBuffer");
}

void OpenClBuffer::write_later(const void* source, std::size_t bytes) {
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

std::unique_ptr<Reading> OpenClBuffer::read_later() const {
  return std::make_unique<OpenClReading>(queue_, handle_, std::max<std::size_t>(bytes_, 1));
}

cl::Int OpenClBuffer::let_go_first() {
  const cl::Int status = queue_->api.WaitForEvents(1, &waiting_.front().done);
  queue_->api.ReleaseEvent(waiting_.front().done);
  waiting_.pop_front();
  return status;
}

bool OpenClBuffer::check_range(std::size_t bytes, std::size_t offset) const {
  if (offset > bytes_ || bytes > bytes_ - offset)
    throw std::out_of_range("buffer of " + std::to_string(bytes_) + " bytes: cannot copy " +
                            std::to_string(bytes) + " at offset " + std::to_string(offset));
  return bytes > 0;
}

void OpenClBuffer::refuse(cl::Int status, std::size_t largest) const {
  const bool no_room = status == cl::kMemoryAllocationFailure || status == cl::kOutOfResources ||
                       status == cl::kOutOfHostMemory || status == cl::kInvalidBufferSize;
  if (!no_room) queue_->check(status, "clCreateBuffer");
  throw InputError(queue_->name() + ": no room for a buffer of " + size_text(bytes_) +
                   "; the device has " + size_text(queue_->info.memory_bytes) + ", at most " +
                   size_text(largest) +
                   " in one piece; use larger voxels, a smaller region or another device");
}

}  // namespace tledface
