// Kernels with their arguments bound, and the arrays that a way of computing a step has of its own.
#pragma once
#include <cstdint>
#include <initializer_list>
#include <memory>
#include <string>
#include <vector>

#include "backend/device.hpp"
#include "precompute/layout.hpp"
#include "sim/force_path.hpp"

namespace tledface {

class Binder {
 public:
  Binder(Device& device, Program& program) : device_(device), program_(program) {}

  std::unique_ptr<Kernel> make(const std::string& name,
                               std::initializer_list<const Buffer*> buffers,
                               std::initializer_list<std::int32_t> integers) const {
    auto kernel = program_.kernel(name);
    unsigned index = 0;
    for (const Buffer* buffer : buffers) kernel->set_arg(index++, *buffer);
    for (const std::int32_t value : integers) kernel->set_arg(index++, value);
    return kernel;
  }

  std::unique_ptr<Buffer> allocate(std::size_t bytes, std::size_t& total) const {
    total += bytes;
    return device_.allocate(bytes);
  }

  std::unique_ptr<Buffer> upload(const std::vector<std::int32_t>& values,
                                 std::size_t& total) const {
    auto buffer = allocate(values.size() * sizeof(std::int32_t), total);
    buffer->write(values.data(), values.size() * sizeof(std::int32_t));
    return buffer;
  }

 private:
  Device& device_;
  Program& program_;
};

inline std::string form_of(const ForcePathOptions& options) {
  return options.hourglass == HourglassForm::kPhysical ? "physical" : "kappa";
}

// Voxels with equal sides, which most models have, need fewer operations.
inline std::string step_form(const SolverArrays& arrays, const ForcePathOptions& options) {
  const double* side = &arrays.shape[SHAPE_GRADIENT];
  const bool cubes = side[0] == side[1] && side[1] == side[2];
  return options.hourglass == HourglassForm::kPhysical && cubes ? "cubes" : form_of(options);
}

}  // namespace tledface
