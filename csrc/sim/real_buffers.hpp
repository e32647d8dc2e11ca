// Reals of a buffer in a device's precision, float64 on the host.
#pragma once
#include <cstddef>
#include <vector>

#include "backend/device.hpp"

namespace tledface {

void write_reals(Buffer& buffer, const std::vector<double>& values, Precision precision);
// Without waiting for what was enqueued before.
void write_reals_later(Buffer& buffer, const std::vector<double>& values, Precision precision);
std::vector<double> read_reals(const Buffer& buffer, std::size_t count, Precision precision);

}  // namespace tledface
