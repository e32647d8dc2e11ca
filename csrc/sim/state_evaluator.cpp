#include "sim/state_evaluator.hpp"

#include <algorithm>

#include "core/threads.hpp"
#include "precompute/layout.hpp"

namespace tledface {
namespace {

template <class T>
std::size_t bytes_of(const std::vector<T>& values) {
  return values.size() * sizeof(T);
}

std::shared_ptr<const SolverArrays> arrays_of(const VoxelModel& model, PrecomputeOptions options,
                                              int lanes,
                                              std::shared_ptr<const SolverArrays> given) {
  options.lanes = lanes;
  options.width = TLED_WIDTH_OF(1, lanes);  // the host has vector rows
  if (given && given->has_blocks(lanes, options.width)) return given;
  return std::make_shared<const SolverArrays>(make_solver_arrays(model, options));
}

}  // namespace

StateEvaluator::StateEvaluator(const VoxelModel& model, PrecomputeOptions options,
                               std::shared_ptr<const SolverArrays> given)
    : host_(make_native_device()),
      shared_arrays_(
          arrays_of(model, options, host_->preferred_lanes(Precision::kDouble), std::move(given))),
      arrays_(*shared_arrays_),
      physical_(options.hourglass == HourglassForm::kPhysical) {
  ProgramOptions program;
  program.precision = Precision::kDouble;
  program.lanes = arrays_.lanes;
  program_ = host_->build(program);
  const std::size_t slots = std::size_t(arrays_.n_blocks + 1) * arrays_.lanes * sizeof(double);
  u_ = host_->allocate(slots * 3);
  state_ = host_->allocate(slots * TLED_STATE_ROWS);
  step_ = host_->allocate((STEP_ACTIVATION + model.muscles.size()) * sizeof(double));
  const bool conforming = model.conforming();
  kernel_ = program_->kernel(conforming ? "hex_state" : "element_state");
  unsigned argument = 0;
  kernel_->set_arg(argument++, *u_);
  kernel_->set_arg(argument++, *state_);
  const auto bind = [&](const void* data, std::size_t bytes) {
    constants_.push_back(upload(data, bytes));
    kernel_->set_arg(argument++, *constants_.back());
  };
  bind(arrays_.blocks.data(), bytes_of(arrays_.blocks));
  bind(arrays_.materials.data(), bytes_of(arrays_.materials));
  bind(arrays_.law_entries.data(), bytes_of(arrays_.law_entries));
  bind(arrays_.law_sets.data(), bytes_of(arrays_.law_sets));
  history_ = host_->allocate(std::max<std::size_t>(arrays_.n_history_rows * arrays_.lanes, 1) *
                             sizeof(double));
  kernel_->set_arg(argument++, *history_);
  kernel_->set_arg(argument++, *history_);
  bind(arrays_.muscle_entries.data(), bytes_of(arrays_.muscle_entries));
  bind(arrays_.muscle_sets.data(), bytes_of(arrays_.muscle_sets));
  bind(arrays_.muscle_constants.data(), bytes_of(arrays_.muscle_constants));
  bind(arrays_.shape.data(), bytes_of(arrays_.shape));
  kernel_->set_arg(argument++, *step_);
  if (conforming) {
    bind(arrays_.hex_nodes.data(), bytes_of(arrays_.hex_nodes));
    bind(arrays_.hex_rows.data(), bytes_of(arrays_.hex_rows));
  }
  kernel_->set_arg(argument++, arrays_.n_blocks);
  kernel_->set_arg(argument++, std::int32_t(physical_));

  growth_ = host_->allocate(slots);
  growth_kernel_ = program_->kernel(conforming ? "hex_growth" : "element_growth");
  argument = 0;
  for (const Buffer* buffer : {u_.get(), growth_.get(), constants_[0].get(), constants_[1].get()})
    growth_kernel_->set_arg(argument++, *buffer);
  // The shape of all voxels, or nodes and rows of each hexahedron.
  for (std::size_t i = conforming ? 8 : 7; i < constants_.size(); ++i)
    growth_kernel_->set_arg(argument++, *constants_[i]);
  growth_kernel_->set_arg(argument, arrays_.n_blocks);
}

std::unique_ptr<Buffer> StateEvaluator::upload(const void* data, std::size_t bytes) {
  auto buffer = host_->allocate(std::max<std::size_t>(bytes, 8));
  buffer->write(data, bytes);
  return buffer;
}

std::vector<double> StateEvaluator::growth(const std::vector<double>& u) {
  const std::lock_guard<std::mutex> lock(mutex_);
  const auto slots = nodes_to_slots(arrays_, u);
  u_->write(slots.data(), bytes_of(slots));
  growth_kernel_->enqueue(std::size_t(arrays_.n_blocks));
  const auto* growth = static_cast<const double*>(growth_->host_pointer());
  std::vector<double> result(arrays_.element_slot.size());
  for (std::size_t e = 0; e < result.size(); ++e) result[e] = growth[arrays_.element_slot[e]];
  return result;
}

ElementState StateEvaluator::evaluate(const std::vector<double>& u,
                                      const std::vector<double>& activations,
                                      const std::vector<double>& history, double dt, double time) {
  const std::lock_guard<std::mutex> lock(mutex_);
  history_->write(history.data(), bytes_of(history));
  const double clock[2] = {dt, time};
  step_->write(clock, sizeof clock, STEP_DT * sizeof(double));
  const auto slots = nodes_to_slots(arrays_, u);
  u_->write(slots.data(), bytes_of(slots));
  step_->write(activations.data(), bytes_of(activations), STEP_ACTIVATION * sizeof(double));
  kernel_->enqueue(std::size_t(arrays_.n_blocks));

  const auto* state = static_cast<const double*>(state_->host_pointer());
  const std::size_t n = arrays_.element_slot.size(), lanes = arrays_.lanes;
  ElementState result;
  result.deformation_gradient.resize(9 * n);
  result.stress.resize(6 * n);
  result.energy_density.resize(n);
  result.hourglass_density.resize(n);
  // Place of component (i, j) of a symmetric tensor: xx yy zz xy yz xz.
  constexpr int place[3][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}};
  const auto& order = arrays_.order;
  parallel_for_chunks(n, 8192, [&](std::size_t begin, std::size_t end) {
    for (std::size_t e = begin; e < end; ++e) {
      const std::size_t slot = arrays_.element_slot[e];
      const double* rows = state + slot / lanes * TLED_STATE_ROWS * lanes + slot % lanes;
      for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
          result.deformation_gradient[9 * e + 3 * order[i] + order[j]] =
              rows[(STATE_F + 3 * i + j) * lanes];
          result.stress[6 * e + place[order[i]][order[j]]] =
              rows[(STATE_SIGMA + place[i][j]) * lanes];
        }
      result.energy_density[e] = rows[STATE_ENERGY * lanes];
      result.hourglass_density[e] = rows[STATE_HOURGLASS * lanes];
    }
  });
  return result;
}

}  // namespace tledface
