// The largest of what work-items find, and checks of a state that copy nothing else to the host
// (kernels_cl/device_checks.cl).
#pragma once
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "backend/device.hpp"
#include "precompute/solver_arrays.hpp"
#include "sim/kernel_binder.hpp"
#include "sim/real_buffers.hpp"

namespace tledface {

// Work-items a group of kernels over many small ones.
constexpr std::size_t kCheckGroup = 64;

// Rows of lanes that a kernel goes through: a block where rows are vectors, else one lane.
struct RowShape {
  bool vectors = true;
  int lanes = 0;
  std::int32_t of_blocks(std::int32_t n_blocks) const {
    return vectors ? n_blocks : n_blocks * lanes;
  }
};

// Of kernels that leave three values and a place for each work-item; see reduce_largest.
class LargestFound {
 public:
  LargestFound(const Binder& binder, Precision precision, RowShape rows);

  // Of a kernel over n_rows, and how to enqueue it.
  std::int32_t n_items(std::int32_t n_rows) const;
  void enqueue(Kernel& kernel, std::int32_t n_items) const;
  const Buffer& values() const { return *values_[0]; }
  const Buffer& places() const { return *places_[0]; }
  // After a kernel of so many work-items: what is left, on the device.
  const Buffer& reduced_places(std::int32_t n_items);
  // The values left by the last reduction.
  std::array<double, 3> largest() const;
  std::size_t bytes() const { return bytes_; }

 private:
  Precision precision_;
  bool vectors_;
  std::int32_t most_items_;
  std::size_t bytes_ = 0;
  int left_ = 0;  // which of the two the last reduction ended in
  std::unique_ptr<Buffer> values_[2], places_[2];
  std::unique_ptr<Kernel> reduce_[2];
};

class StateChecks {
 public:
  StateChecks(const Binder& binder, Precision precision, RowShape rows, std::int32_t n_blocks);
  bool is_finite(const Buffer& u);
  // u_prev, moved to where it would be with a last step of `ratio` times the length.
  void scale_last_step(const Buffer& u, const Buffer& u_prev, double ratio);
  std::size_t bytes() const { return bytes_ + found_.bytes(); }

 private:
  Precision precision_;
  std::int32_t n_rows_, n_items_;
  std::size_t bytes_ = 0;
  LargestFound found_;
  std::unique_ptr<Buffer> ratio_;
  std::unique_ptr<Kernel> find_, scale_;
};

}  // namespace tledface
