// The parts of Simulator beside the steps: prescribed values out of turn, external forces on the
// host, the limit of the step, and relaxation: pseudo-steps with nodal masses of their own.
#include <algorithm>
#include <cmath>
#include <string>

#include "core/error.hpp"
#include "precompute/layout.hpp"
#include "sim/simulator.hpp"

namespace tledface {
namespace {

// Equilibrium is what viscous stresses have left: they decay over this time (s) in each step.
constexpr double kForever = 1e9;

constexpr double kInvertedGrowth = 8;

}  // namespace

Simulator::~Simulator() = default;

void Simulator::set_prescribed(const std::vector<double>& values,
                               const std::vector<double>& fields) {
  const Conditions& given = conditions_->given();
  if (values.size() != static_cast<std::size_t>(given.n_prescribed) ||
      fields.size() != given.field_dofs.size())
    throw InputError("set_prescribed: one value a channel and a field's node is needed");
  auto u = displacement();
  for (std::size_t i = 0; i < given.prescribed_dofs.size(); ++i)
    u[given.prescribed_dofs[i]] = values[given.prescribed_channels[i]];
  for (std::size_t i = 0; i < fields.size(); ++i) u[given.field_dofs[i]] = fields[i];
  const auto slots = nodes_to_slots(arrays_, u);
  // Free components keep what they have, velocity included.
  auto before = slots_to_nodes(arrays_, read_slots(*u_[1 - now_]));
  for (const std::int64_t dof : given.prescribed_dofs) before[dof] = u[dof];
  for (const std::int64_t dof : given.field_dofs) before[dof] = u[dof];
  write_reals(*u_[now_], slots);
  write_reals(*u_[1 - now_], nodes_to_slots(arrays_, before));
}

std::vector<double> Simulator::external_force(const std::vector<double>& values) {
  if (values.size() != n_values())
    throw InputError("external_force: one value a channel is needed");
  auto force = conditions_->force(displacement(), values.data());
  for (std::size_t n = 0; n < arrays_.node_mass.size(); ++n)
    for (int c = 0; c < 3; ++c) force[3 * n + c] += arrays_.node_mass[n] * model_.gravity[c];
  return force;
}

StepLimiter& Simulator::limiter() {
  if (!limiter_) {
    auto bounds =
        std::make_unique<StepBounds>(*device_, *program_, model_, arrays_, solver_buffers(),
                                     path_->hexahedra(), options_.precision, row_shape());
    limiter_ = std::make_unique<StepLimiter>(*this, std::move(bounds));
    device_bytes_ += limiter_->bytes();
  }
  return *limiter_;
}

StepLimit Simulator::limit_now(const FibreReach& reach, double enough) {
  check_activations("limit_now", reach.activations);
  return limiter().limit(reach, enough);
}

StepLimit Simulator::measured_limit(const std::vector<double>& activations) {
  check_activations("measured_limit", activations);
  return limiter().measure(activations);
}

std::vector<double> Simulator::relaxation_masses() {
  auto growth = evaluator().growth(displacement());
  // An inverted element must stay free to turn back.
  for (double& value : growth)
    if (!(value > 0)) value = kInvertedGrowth;
  auto masses = node_stiffness(model_, arrays_, element_stiffness(model_, growth));
  for (double& mass : masses) mass /= 4;  // omega = 2
  return masses;
}

void Simulator::begin_relaxation(const std::vector<double>& node_mass) {
  const std::size_t n_nodes = arrays_.node_mass.size(), lanes = arrays_.lanes;
  if (node_mass.size() != n_nodes ||
      !std::all_of(node_mass.begin(), node_mass.end(), [](double m) { return m > 0; }))
    throw InputError("begin_relaxation: one positive mass a node is needed");
  device_->finish();
  std::vector<double> inverse(std::size_t(arrays_.n_blocks + 1) * TLED_NODE_ROWS * lanes, 0.0);
  for (std::size_t n = 0; n < n_nodes; ++n) {
    const std::size_t slot = arrays_.node_slot[n];
    for (int c = 0; c < 3; ++c)
      if (!model_.fixed[3 * n + arrays_.order[c]])
        inverse[(slot / lanes * TLED_NODE_ROWS + c) * lanes + slot % lanes] = 1 / node_mass[n];
  }
  if (!relaxation_) {
    relaxation_ = std::make_unique<Relaxation>();
    auto links = arrays_.blocks;
    for (std::int32_t b = 0; b <= arrays_.n_blocks; ++b)
      links[std::size_t(b) * TLED_BLOCK_INTS + BLOCK_NODE] = b;
    relaxation_->blocks = device_->allocate(links.size() * sizeof(std::int32_t));
    relaxation_->blocks->write(links.data(), links.size() * sizeof(std::int32_t));
    relaxation_->node_sets = device_->allocate(inverse.size() * real_size(options_.precision));
    Conditions gravity;
    for (std::size_t n = 0; n < n_nodes; ++n)
      for (int c = 0; c < 3; ++c)
        if (model_.gravity[c] != 0 && !model_.fixed[3 * n + c]) {
          gravity.load_dofs.push_back(static_cast<std::int64_t>(3 * n + c));
          gravity.load_channels.push_back(0);
          gravity.load_forces.push_back(arrays_.node_mass[n] * model_.gravity[c]);
        }
    gravity.n_loads = gravity.load_dofs.empty() ? 0 : 1;
    relaxation_->gravity =
        std::make_unique<NodalConditions>(std::move(gravity), model_, arrays_, *device_, *program_,
                                          options_.precision, std::int32_t(STEP_UNIT), 1);
  }
  write_reals(*relaxation_->node_sets, inverse);
  bind_masses(*relaxation_->blocks, *relaxation_->node_sets);
  const Buffer* const u[2] = {u_[0].get(), u_[1].get()};
  relaxation_->gravity->bind(u, *relaxation_->blocks, *relaxation_->node_sets, *step_table_,
                             step_reals_);
  // Pseudo-steps are of one length, so sliding nodes are due in each, whatever their level.
  if (sliding_) sliding_->set_has_levels(false);
}

void Simulator::relax(const std::vector<RelaxationStep>& steps, const StepInput& input) {
  if (!relaxation_) throw InputError("relax: begin_relaxation comes first");
  check_input("relax", steps.size(), input, 2);
  const std::size_t n_muscles = model_.muscles.size(), n_values = this->n_values();
  if (conditions_->n_fields()) conditions_->write_keys(input.keys.data(), 2);
  std::vector<double> table;
  for (std::size_t done = 0; done < steps.size();) {
    const std::size_t batch = std::min(largest_batch(), steps.size() - done);
    table.assign(batch * step_reals_, 0.0);
    for (std::size_t i = 0; i < batch; ++i) {
      const RelaxationStep& step = steps[done + i];
      double* row = &table[i * step_reals_];
      row[STEP_VELOCITY] = step.velocity;
      row[STEP_FORCE] = step.force;
      fill_step(row, input.activations.data() + (done + i) * n_muscles,
                input.values.data() + (done + i) * n_values, {0, step.field_weight});
      row[STEP_DT] = kForever;
    }
    write_table(table);
    for (std::size_t i = 0; i < batch; ++i) {
      enqueue_step(now_, static_cast<std::int32_t>(i), -1);
      relaxation_->gravity->enqueue(now_, static_cast<std::int32_t>(i));
      if (sliding_)
        sliding_->enqueue(1 - now_, static_cast<std::int32_t>(i), done + i + 1 == steps.size());
      now_ = 1 - now_;
    }
    done += batch;
  }
}

void Simulator::end_relaxation() {
  if (!relaxation_) return;
  device_->finish();
  relaxation_.reset();
  bind_masses(*blocks_, *node_sets_);
  if (sliding_) sliding_->set_has_levels(levels_.n_levels > 1);
  write_reals(*u_[1 - now_], read_slots(*u_[now_]));
  starts_ = true;
}

std::unique_ptr<Simulator> Simulator::in_double() {
  SimulatorOptions options = options_;
  options.precision = Precision::kDouble;
  options.n_bands = 0;
  options.axis_order = arrays_.order;  // the past is in these axes
  auto device = device_;
  if (!device->info().has_double) {
    device = make_native_device();
    options.kernels = KernelPath::kAuto;
  }
  auto exact =
      std::make_unique<Simulator>(std::move(device), model_, options, conditions(), sliding_given_);
  exact->set_dt(dt_);
  exact->take_state(*this);
  exact->starts_ = true;
  return exact;
}

void Simulator::take_state(Simulator& other) {
  const auto slots = nodes_to_slots(arrays_, other.displacement());
  for (auto& buffer : u_) write_reals(*buffer, slots);
  const auto past = other.history();
  if (past.empty()) return;
  const auto rows = history_in_layout(model_, other.arrays_, past, arrays_);
  for (auto& buffer : history_) write_reals(*buffer, rows);
}

}  // namespace tledface
