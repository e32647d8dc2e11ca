#include "sim/real_buffers.hpp"

#include <algorithm>

namespace tledface {

void write_reals(Buffer& buffer, const std::vector<double>& values, Precision precision) {
  if (values.empty()) return;
  if (precision == Precision::kDouble) {
    buffer.write(values.data(), values.size() * sizeof(double));
  } else {
    const std::vector<float> narrow(values.begin(), values.end());
    buffer.write(narrow.data(), narrow.size() * sizeof(float));
  }
}

void write_reals_later(Buffer& buffer, const std::vector<double>& values, Precision precision) {
  if (precision == Precision::kDouble) {
    buffer.write_later(values.data(), values.size() * sizeof(double));
  } else {
    const std::vector<float> narrow(values.begin(), values.end());
    buffer.write_later(narrow.data(), narrow.size() * sizeof(float));
  }
}

std::vector<double> read_reals(const Buffer& buffer, std::size_t count, Precision precision) {
  std::vector<double> values(count);
  if (precision == Precision::kDouble) {
    buffer.read(values.data(), count * sizeof(double));
  } else {
    std::vector<float> narrow(count);
    buffer.read(narrow.data(), count * sizeof(float));
    std::copy(narrow.begin(), narrow.end(), values.begin());
  }
  return values;
}

}  // namespace tledface
