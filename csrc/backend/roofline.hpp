// What a device can do at best, measured on it with the same executor, threads and vector width as
// the solver: what its speed is reported beside (kernels_cl/roofline.cl).
#pragma once
#include <cstddef>
#include <memory>

#include "backend/device.hpp"

namespace tledface {

// Vector instructions by kind; only their ratio matters to Roofline. What selects or compares
// counts as an addition: it takes the same units.
struct InstructionMix {
  double fused = 1, multiplied = 0, added = 0;  // multiply-adds, products, sums
  double total() const { return fused + multiplied + added; }
};

class Roofline {
 public:
  // bytes: of the two arrays that memory is measured with, together. The mix is rounded to what the
  // kernel can do, see mix().
  Roofline(std::shared_ptr<Device> device, Precision precision, std::size_t bytes,
           const InstructionMix& mix);
  ~Roofline();

  // Each a block of launches for about so many seconds:
  double axpy(double seconds);  // GB/s of y += a x: read x and y, write y
  double copy(double seconds);  // GB/s of y = x: read x, write y
  // Instructions a second, each on one real (a vector instruction of 8 lanes counts 8), in G.
  double instructions(double seconds);

  const InstructionMix& mix() const { return mix_; }

 private:
  struct Block;
  double launches_per_second(Block& block, double seconds);

  std::shared_ptr<Device> device_;
  Precision precision_;
  InstructionMix mix_;
  std::size_t n_items_ = 0, n_reals_ = 0, arithmetic_items_ = 0, axpy_passes_ = 1;
  double instructions_a_launch_ = 0;
  std::unique_ptr<Program> program_;
  std::unique_ptr<Buffer> x_, y_, out_;
  std::unique_ptr<Block> axpy_, copy_, mixed_;
};

}  // namespace tledface
