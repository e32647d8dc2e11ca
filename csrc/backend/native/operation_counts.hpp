// Vector instructions by kind, and the native executor that counts them (counted.hpp).
#pragma once
#include <memory>

#include "backend/device.hpp"

namespace tledface::native {

struct OperationCounts {
  double fused = 0, multiplied = 0, added = 0;  // multiply-adds, products, sums
  double selected = 0;                          // comparisons, selections, signs
  double divided = 0, roots = 0;
  double shuffled = 0;  // rows moved by a lane
};

// What the calling thread has counted since the last call.
OperationCounts take_operation_counts();

// Kernels in single precision with blocks of one lane.
std::shared_ptr<Device> make_counting_device();

}  // namespace tledface::native
