#include "sim/simulator.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "precompute/layout.hpp"
#include "sim/kernel_binder.hpp"
#include "sim/kernel_choice.hpp"

namespace tledface {
namespace {

// A step below 0 asks laws for their answer without relaxation and flow; its size is none.
constexpr double kInstant = -1e-30;

// Tiles are made for 512 work-items at a time on a unit with 65 536 registers. Of the other kernels
// of float32 only slide_nodes would take more (170).
constexpr int kTileRegisters = 128;

// Where none are asked for: the kernels that were fastest on the device (kernel_choice.hpp).
SimulatorOptions with_choice(SimulatorOptions options, const Device& device) {
  if (options.kernels != KernelPath::kAuto) return options;
  if (const auto choice = chosen_kernels(device.info().id, options.precision, options.hourglass)) {
    options.kernels = choice->path;
    options.tile = choice->tile;
    options.registers = choice->registers;
  }
  return options;
}

bool takes_rows(const SimulatorOptions& options, const Device& device) {
  return options.kernels == KernelPath::kRows ||
         (options.kernels == KernelPath::kAuto && device.prefers_vector_rows());
}

PrecomputeOptions precompute_options(const SimulatorOptions& options, const Device& device) {
  if (options.precision == Precision::kDouble && !device.info().has_double)
    throw InputError("precision: device '" + device.info().id + "' (" + device.info().name +
                     ") has no float64; use precision='single'");
  PrecomputeOptions precompute;
  precompute.lanes = device.preferred_lanes(options.precision);
  precompute.width = TLED_WIDTH_OF(takes_rows(options, device), precompute.lanes);
  precompute.hourglass = options.hourglass;
  precompute.kappa = options.kappa;
  precompute.axis_order = options.axis_order;
  return precompute;
}

std::shared_ptr<const SolverArrays> arrays_of(VoxelModel& model, const SimulatorOptions& options,
                                              const PrecomputeOptions& precompute) {
  if (model.conforming() && options.hourglass == HourglassForm::kKappa)
    set_kappa_stiffening(model, options.kappa);
  if (options.arrays && options.arrays->has_blocks(precompute.lanes, precompute.width))
    return options.arrays;
  return std::make_shared<const SolverArrays>(make_solver_arrays(model, precompute));
}

}  // namespace

Simulator::Simulator(std::shared_ptr<Device> device, VoxelModel model,
                     const SimulatorOptions& options, Conditions conditions, SlidingNodes sliding)
    : device_(std::move(device)),
      model_(std::move(model)),
      options_(with_choice(options, *device_)),
      precompute_(precompute_options(options_, *device_)),
      shared_arrays_(arrays_of(model_, options_, precompute_)),
      arrays_(*shared_arrays_) {
  options_.arrays = nullptr;
  const bool chosen = options.kernels != options_.kernels;
  records_ = device_->info().command_buffers &&
             options_.recorded.value_or(chosen_recording(device_->info().id));
  rows_ = takes_rows(options_, *device_);
  ProgramOptions program;
  program.precision = options_.precision;
  program.lanes = precompute_.lanes;
  program.vector_rows = rows_;
  program.laws = rows_ || !arrays_.law_entries.empty();
  // Laws need the registers that a limit would take.
  if (options_.kernels == KernelPath::kTile && options_.precision == Precision::kSingle &&
      !program.laws)
    program.registers = kTileRegisters;
  program_ = device_->build(program);
  if (options_.registers && !program.laws) {
    program.registers = options_.registers;
    path_program_ = device_->build(program);
  }
  const auto first_column = static_cast<std::int32_t>(STEP_ACTIVATION + model_.muscles.size());
  step_reals_ = first_column + NodalConditions::n_columns(conditions) +
                static_cast<std::int32_t>(sliding.moving.size() * Sliding::kPoseValues);

  const std::size_t real = real_size(options_.precision), lanes = arrays_.lanes,
                    slots = std::size_t(arrays_.n_blocks + 1) * lanes;
  const auto allocate = [&](std::size_t bytes) {
    device_bytes_ += bytes;
    return device_->allocate(bytes);
  };
  for (auto& buffer : u_) buffer = allocate(slots * 3 * real);
  blocks_ = upload(arrays_.blocks);
  materials_ = upload(arrays_.materials);
  node_sets_ = upload(arrays_.node_sets);
  law_entries_ = upload(arrays_.law_entries);
  law_sets_ = upload(arrays_.law_sets);
  // Read and written in turns: a band's seeds are computed by two work-items.
  for (auto& buffer : history_)
    buffer = allocate(std::max<std::size_t>(arrays_.n_history_rows * lanes, 1) * real);
  muscle_entries_ = upload(arrays_.muscle_entries);
  muscle_sets_ = upload(arrays_.muscle_sets);
  muscle_constants_ = upload(arrays_.muscle_constants);
  shape_ = upload(arrays_.shape);
  step_table_ = allocate(largest_batch() * step_reals_ * real);
  ForcePathOptions path;
  path.precision = options_.precision;
  path.hourglass = options_.hourglass;
  path.rows = rows_;
  path.tiles = options_.kernels == KernelPath::kTile;
  path.tile = options_.tile;
  path.n_bands = options_.n_bands;
  path.step_reals = step_reals_;
  const auto make_path = [&] {
    return make_force_path(*device_, path_program_ ? *path_program_ : *program_, arrays_,
                           solver_buffers(), path);
  };
  try {
    path_ = make_path();
  } catch (const InputError&) {
    if (!chosen || !path.tiles) throw;
    // This model's kernels need more of a work-group than those that were measured.
    options_.kernels = KernelPath::kGather;
    path.tiles = false;
    path_ = make_path();
  }
  device_bytes_ += path_->bytes();
  levels_ = same_level(arrays_);
  conditions_ =
      std::make_unique<NodalConditions>(std::move(conditions), model_, arrays_, *device_, *program_,
                                        options_.precision, first_column, largest_batch());
  device_bytes_ += conditions_->bytes();
  sliding_given_ = std::move(sliding);
  if (!sliding_given_.empty()) {
    sliding_ = std::make_unique<Sliding>(sliding_given_, model_, arrays_, *device_, *program_,
                                         options_.precision, rows_, path.tiles, pose_column());
    device_bytes_ += sliding_->bytes();
    const Buffer* const u[2] = {u_[0].get(), u_[1].get()};
    sliding_->bind(u, *blocks_, *step_table_, step_reals_);
    const auto rows = sliding_->row_buffers();
    if (rows && !conditions_->any_acts_on(sliding_given_.nodes)) {
      device_bytes_ -= path_->bytes();
      fuses_sliding_ = path_->fuse_sliding(*rows);
      device_bytes_ += path_->bytes();
    }
  }
  bind_masses(*blocks_, *node_sets_);
}

const char* Simulator::kernels() const {
  if (model_.conforming()) return "hexahedra";
  if (rows_) return "rows";
  return options_.kernels == KernelPath::kTile ? "tile" : "gather";
}

std::unique_ptr<Buffer> Simulator::upload(const std::vector<double>& values, std::size_t at_least) {
  const std::size_t bytes = std::max(values.size(), at_least) * real_size(options_.precision);
  device_bytes_ += bytes;
  auto buffer = device_->allocate(bytes);
  write_reals(*buffer, values);
  return buffer;
}

std::unique_ptr<Buffer> Simulator::upload(const std::vector<std::int32_t>& values) {
  const std::size_t bytes = std::max<std::size_t>(values.size(), 1) * sizeof(std::int32_t);
  device_bytes_ += bytes;
  auto buffer = device_->allocate(bytes);
  if (!values.empty()) buffer->write(values.data(), values.size() * sizeof(std::int32_t));
  return buffer;
}

void Simulator::write_reals(Buffer& buffer, const std::vector<double>& values) {
  tledface::write_reals(buffer, values, options_.precision);
}

void Simulator::write_table(const std::vector<double>& rows) {
  write_reals_later(*step_table_, rows, options_.precision);
}

SolverBuffers Simulator::solver_buffers() const {
  return {{u_[0].get(), u_[1].get()},
          {history_[0].get(), history_[1].get()},
          blocks_.get(),
          materials_.get(),
          node_sets_.get(),
          law_entries_.get(),
          law_sets_.get(),
          muscle_entries_.get(),
          muscle_sets_.get(),
          muscle_constants_.get(),
          shape_.get(),
          step_table_.get()};
}

void Simulator::bind_masses(const Buffer& blocks, const Buffer& node_sets) {
  forget_recordings();
  path_->bind_masses(blocks, node_sets);
  const Buffer* const u[2] = {u_[0].get(), u_[1].get()};
  conditions_->bind(u, blocks, node_sets, *step_table_, step_reals_);
}

std::vector<double> Simulator::read_slots(const Buffer& buffer) {
  return read_reals(buffer, std::size_t(arrays_.n_blocks + 1) * arrays_.lanes * 3);
}

std::vector<double> Simulator::read_reals(const Buffer& buffer, std::size_t count) {
  device_->finish();
  return tledface::read_reals(buffer, count, options_.precision);
}

std::vector<double> Simulator::displacement() {
  return slots_to_nodes(arrays_, read_slots(*u_[now_]));
}

std::vector<double> Simulator::velocity() {
  const auto now = read_slots(*u_[now_]), before = read_slots(*u_[1 - now_]);
  std::vector<double> v(now.size());
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = (now[i] - before[i]) / step_of_real(i);
  return slots_to_nodes(arrays_, v);
}

void Simulator::set_state(const std::vector<double>& u, const std::vector<double>& velocity,
                          double time) {
  const auto now = nodes_to_slots(arrays_, u);
  write_reals(*u_[now_], now);
  auto before = now;
  if (!velocity.empty()) {
    // Nothing slows a fixed component down: it would go on for ever.
    auto free = velocity;
    for (std::size_t i = 0; i < free.size(); ++i)
      if (model_.fixed[i]) free[i] = 0;
    const auto v = nodes_to_slots(arrays_, free);
    for (std::size_t i = 0; i < before.size(); ++i) before[i] -= step_of_real(i) * v[i];
  }
  write_reals(*u_[1 - now_], before);
  for (auto& buffer : history_)
    write_reals(*buffer, std::vector<double>(std::size_t(arrays_.n_history_rows) * arrays_.lanes));
  if (sliding_) sliding_->forget();
  clock_start_ = time;
  clock_steps_ = n_steps_ = 0;
  starts_ = true;
}

RawState Simulator::raw_state() {
  device_->finish();
  RawState state;
  for (const int parity : {now_, 1 - now_}) {
    auto& bytes = parity == now_ ? state.u : state.u_prev;
    bytes.resize(u_[parity]->bytes());
    u_[parity]->read(bytes.data(), bytes.size());
  }
  state.history.resize(history_[now_]->bytes());
  history_[now_]->read(state.history.data(), state.history.size());
  state.clock_start = clock_start_;
  state.clock_steps = clock_steps_;
  state.dt = dt_;
  state.n_steps = n_steps_;
  state.starts = starts_;
  if (limiter_) {
    state.limit_squares = limiter_->last_squares();
    state.limit_square = limiter_->last_square();
  }
  if (state.limit_squares.empty()) state.limit_squares = {0};  // files take no empty array
  state.sliding = sliding_ ? sliding_->state() : std::vector<std::uint8_t>{0};
  state.levels = levels_.nodes;
  state.levels.insert(state.levels.end(), levels_.elements.begin(), levels_.elements.end());
  return state;
}

void Simulator::set_raw_state(const RawState& state) {
  if (state.u.size() != u_[0]->bytes() || state.u_prev.size() != u_[0]->bytes() ||
      state.history.size() != history_[0]->bytes())
    throw InputError("state: it holds " + std::to_string(state.u.size()) +
                     " bytes, this model on "
                     "this device in this precision has " +
                     std::to_string(u_[0]->bytes()) +
                     "; restore with the model, precision and device it was saved with");
  if (state.limit_square > 0 && state.limit_squares.size() != arrays_.node_mass.size())
    throw InputError("state: the stiffness of " + std::to_string(state.limit_squares.size()) +
                     " nodes, this model has " + std::to_string(arrays_.node_mass.size()));
  BlockLevels levels = same_level(arrays_);
  levels.n_levels = levels_.n_levels;
  if (!state.levels.empty()) {
    const std::size_t n_blocks = levels.nodes.size();
    if (state.levels.size() != 2 * n_blocks ||
        *std::max_element(state.levels.begin(), state.levels.end()) >= levels.n_levels)
      throw InputError(
          "state: its levels of subcycling are not those of this model on this device");
    levels.nodes.assign(state.levels.begin(), state.levels.begin() + n_blocks);
    levels.elements.assign(state.levels.begin() + n_blocks, state.levels.end());
  }
  const bool knows_sliding = sliding_ && state.sliding.size() > 1;
  if (knows_sliding) sliding_->check_state(state.sliding);
  StepLimiter* const limits = limiter_ || state.limit_square > 0 ? &limiter() : nullptr;
  // What may be refused has been: from here on all of the state is taken.
  take_levels(std::move(levels));
  device_->finish();
  u_[now_]->write(state.u.data(), state.u.size());
  u_[1 - now_]->write(state.u_prev.data(), state.u_prev.size());
  history_[now_]->write(state.history.data(), state.history.size());
  clock_start_ = state.clock_start;
  clock_steps_ = state.clock_steps;
  dt_ = state.dt;
  n_steps_ = state.n_steps;
  starts_ = state.starts;
  if (knows_sliding)
    sliding_->set_state(state.sliding);
  else if (sliding_)
    sliding_->forget();
  if (limits) limits->restore(state.limit_squares, state.limit_square);
}

void Simulator::set_dt(double dt) {
  if (!(dt > 0) || !std::isfinite(dt))
    throw InputError("dt: got " + std::to_string(dt) + ", allowed is a positive number of seconds");
  if (dt_ > 0 && dt != dt_) {
    checks().scale_last_step(*u_[now_], *u_[1 - now_], dt / dt_);
  }
  clock_start_ = time();
  clock_steps_ = 0;
  dt_ = dt;
}

TimeStepBound Simulator::bound_at_rest() const {
  const auto stiffness = element_stiffness(model_);
  return time_step_bound(model_, arrays_, stiffness, node_stiffness(model_, arrays_, stiffness));
}

StateEvaluator& Simulator::evaluator() {
  const std::lock_guard<std::mutex> lock(evaluator_mutex_);
  if (!evaluator_) {
    PrecomputeOptions options = precompute_;
    options.axis_order = arrays_.order;  // history is in these axes
    evaluator_ = std::make_unique<StateEvaluator>(model_, options, shared_arrays_);
  }
  return *evaluator_;
}

void Simulator::check_activations(const char* what, const std::vector<double>& activations) const {
  if (activations.size() != model_.muscles.size())
    throw InputError(std::string(what) + ": one activation a muscle is needed");
}

std::vector<double> Simulator::internal_force(const std::vector<double>& activations) {
  check_activations("internal_force", activations);
  return force_at(starts_ ? 0 : dt_, activations);
}

std::vector<double> Simulator::history() {
  if (!arrays_.n_history_rows) return {};
  return read_reals(*history_[now_], std::size_t(arrays_.n_history_rows) * arrays_.lanes);
}

const double* Simulator::instant_force_in_place(const std::vector<double>& past,
                                                const std::vector<double>& activations) {
  write_reals(*history_[now_], past);
  if (!force_) force_ = device_->allocate(u_[0]->bytes());
  enqueue_force(kInstant, activations, *force_);
  device_->finish();
  return static_cast<const double*>(force_->host_pointer());
}

void Simulator::enqueue_force(double dt, const std::vector<double>& activations, Buffer& force,
                              bool weighted) {
  std::vector<double> row(step_reals_, 0.0);
  for (int level = 0; level < levels_.n_levels; ++level)
    row[level * TLED_STEP_LEVEL + STEP_DUE] = weighted ? std::ldexp(1.0, level) : 1.0;
  row[STEP_DT] = dt;
  row[STEP_TIME] = time();
  std::copy(activations.begin(), activations.end(), row.begin() + STEP_ACTIVATION);
  write_table(row);
  path_->enqueue_forces(now_, force);
}

std::vector<double> Simulator::force_at(double dt, const std::vector<double>& activations,
                                        bool weighted) {
  auto force = device_->allocate(u_[0]->bytes());
  enqueue_force(dt, activations, *force, weighted);
  return slots_to_nodes(arrays_, read_slots(*force));
}

ElementState Simulator::element_state(const std::vector<double>& activations) {
  check_activations("element_state", activations);
  return element_state_at(displacement(), history(), activations, starts_ ? 0 : dt_, time());
}

ElementState Simulator::element_state_at(const std::vector<double>& u,
                                         const std::vector<double>& past,
                                         const std::vector<double>& activations, double dt,
                                         double time) {
  StateEvaluator& evaluator = this->evaluator();
  std::vector<double> history;
  if (arrays_.n_history_rows)
    history = history_in_layout(model_, arrays_, past, evaluator.arrays());
  return evaluator.evaluate(u, activations, history, dt, time);
}

StateChecks& Simulator::checks() {
  if (!checks_) {
    checks_ = std::make_unique<StateChecks>(Binder(*device_, *program_), options_.precision,
                                            row_shape(), arrays_.n_blocks);
    device_bytes_ += checks_->bytes();
  }
  return *checks_;
}

std::int64_t Simulator::first_non_finite_node() {
  if (checks().is_finite(*u_[now_])) return -1;
  const auto u = displacement();
  for (std::size_t i = 0; i < u.size(); ++i)
    if (!std::isfinite(u[i])) return static_cast<std::int64_t>(i / 3);
  return -1;
}

}  // namespace tledface
