#include "sim/operation_count.hpp"

#include "core/error.hpp"
#include "sim/simulator.hpp"

namespace tledface {

native::OperationCounts operations_per_element(VoxelModel model, HourglassForm hourglass,
                                               const std::array<int, 3>& axis_order) {
  if (model.conforming())
    throw InputError("operations_per_element: got a conforming mesh, allowed is a voxel model");
  const auto n_elements = static_cast<double>(model.n_elements());
  const std::size_t n_muscles = model.muscles.size();
  SimulatorOptions options;
  options.hourglass = hourglass;
  options.axis_order = axis_order;
  options.n_bands = 1;  // all in this thread, no chunk twice
  Simulator sim(native::make_counting_device(), std::move(model), options);
  sim.set_dt(0.8 * sim.bound_at_rest().dt);
  native::take_operation_counts();
  sim.step(1, {std::vector<double>(n_muscles, 0.0), {}, {}});
  auto counts = native::take_operation_counts();
  for (double* count : {&counts.fused, &counts.multiplied, &counts.added, &counts.selected,
                        &counts.divided, &counts.roots, &counts.shuffled})
    *count /= n_elements;
  return counts;
}

}  // namespace tledface
