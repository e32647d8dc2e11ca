// Memory of an OpenCL device.
#pragma once
#include <cstdint>
#include <deque>
#include <memory>
#include <vector>

#include "backend/opencl/opencl_queue.hpp"

namespace tledface {

class OpenClBuffer final : public Buffer {
 public:
  // Zero-filled; InputError where there is no room.
  OpenClBuffer(std::shared_ptr<OpenClQueue> queue, std::size_t bytes);
  ~OpenClBuffer() override;
  OpenClBuffer(const OpenClBuffer&) = delete;
  OpenClBuffer& operator=(const OpenClBuffer&) = delete;

  std::size_t bytes() const override { return bytes_; }
  void write(const void* source, std::size_t bytes, std::size_t offset) override;
  void read(void* target, std::size_t bytes, std::size_t offset) const override;
  void write_later(const void* source, std::size_t bytes) override;
  std::unique_ptr<Reading> read_later() const override;
  void* opencl_handle() const override { return handle_; }

 private:
  struct Waiting {
    std::vector<std::uint8_t> bytes;
    cl::Event done;
  };

  // Zero-filled memory of ours that a CPU works in, since its driver's own has small pages; null:
  // the driver is to take its own.
  cl::Memory create_in_large_pages(std::size_t bytes) const;
  // Waits for the first that is being written.
  cl::Int let_go_first();
  // False where there is nothing to copy; OpenCL has no empty transfer.
  bool check_range(std::size_t bytes, std::size_t offset) const;
  [[noreturn]] void refuse(cl::Int status, std::size_t largest) const;

  std::shared_ptr<OpenClQueue> queue_;
  std::size_t bytes_;
  cl::Memory handle_ = nullptr;
  std::deque<Waiting> waiting_;
};

}  // namespace tledface
