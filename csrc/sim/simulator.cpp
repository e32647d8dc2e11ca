#include "sim/simulator.hpp"

#include <algorithm>
#include <cmath>

#include "core/error.hpp"
#include "precompute/layout.hpp"

namespace tledface {
namespace {

// Steps of one table of activations: long enough that writing it costs nothing.
constexpr std::size_t kBatch = 256;
// Where the kernels take the index of the step in the table.
constexpr unsigned kRowsStepIndex = 16, kElementsStepIndex = 10, kNodesStepIndex = 7;
// Work-items a group of the gather kernels: four blocks of 16 lanes.
constexpr std::size_t kGroup = 64;
constexpr std::size_t kScratchRows = 4;  // SCRATCH_ROWS of kernels_cl/rows.cl

template <class T>
std::vector<T> narrowed(const std::vector<double>& values) {
  return std::vector<T>(values.begin(), values.end());
}

}  // namespace

Simulator::Simulator(std::shared_ptr<Device> device, VoxelModel model,
                     const SimulatorOptions& options)
    : device_(std::move(device)), model_(std::move(model)), options_(options) {
  rows_ = options_.kernels == KernelPath::kRows ||
          (options_.kernels == KernelPath::kAuto && device_->prefers_vector_rows());
  if (options_.precision == Precision::kDouble && !device_->info().has_double)
    throw InputError("precision: device '" + device_->info().id + "' (" + device_->info().name +
                     ") has no float64; use precision='single'");
  ProgramOptions program;
  program.precision = options_.precision;
  program.lanes = device_->preferred_lanes(options_.precision);
  program.vector_rows = rows_;
  program_ = device_->build(program);

  precompute_.lanes = program.lanes;
  precompute_.hourglass = options_.hourglass;
  precompute_.kappa = options_.kappa;
  precompute_.mass_scaling = options_.mass_scaling;
  arrays_ = make_solver_arrays(model_, precompute_);
  step_reals_ = static_cast<std::int32_t>(STEP_ACTIVATION + model_.muscles.size());

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
  muscle_entries_ = upload(arrays_.muscle_entries);
  muscle_sets_ = upload(arrays_.muscle_sets);
  muscle_constants_ = upload(arrays_.muscle_constants);
  shape_ = upload(arrays_.shape);
  step_table_ = allocate(kBatch * step_reals_ * real);
  if (rows_) {
    // Two bands a compute unit: enough to level them out, few enough that seed rows cost little.
    const std::size_t wanted =
        options_.n_bands ? options_.n_bands : 2 * std::size_t(device_->info().compute_units);
    bands_ = arrays_.make_bands(wanted);
    bands_buffer_ = upload(bands_.bands);
    row_buffer_ = upload(bands_.rows);
    scratch_ = allocate(bands_.n_bands() * bands_.n_planes * kScratchRows * lanes * real);
    edge_ = allocate(std::size_t(arrays_.n_blocks + 1) * 4 * real);
  } else {
    element_forces_ = allocate(slots * 24 * real);
  }
  bind();
}

Simulator::~Simulator() = default;

std::unique_ptr<Buffer> Simulator::upload(const std::vector<double>& values, std::size_t at_least) {
  const std::size_t bytes =
      std::max(values.size(), at_least) * real_size(options_.precision);
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
  if (values.empty()) return;
  if (options_.precision == Precision::kDouble) {
    buffer.write(values.data(), values.size() * sizeof(double));
  } else {
    const auto narrow = narrowed<float>(values);
    buffer.write(narrow.data(), narrow.size() * sizeof(float));
  }
}

void Simulator::bind() {
  const auto make = [&](const std::string& name, std::initializer_list<const Buffer*> buffers,
                        std::initializer_list<std::int32_t> integers) {
    auto kernel = program_->kernel(name);
    unsigned index = 0;
    for (const Buffer* buffer : buffers) kernel->set_arg(index++, *buffer);
    for (const std::int32_t value : integers) kernel->set_arg(index++, value);
    return kernel;
  };
  const std::string form =
      options_.hourglass == HourglassForm::kPhysical ? "physical" : "kappa";
  for (int parity = 0; parity < 2; ++parity) {
    Buffer *u = u_[parity].get(), *other = u_[1 - parity].get();
    if (rows_) {
      for (const bool forces : {false, true})
        (forces ? force_ : step_)[parity] = make(
            (forces ? "force_rows_" : "step_rows_") + form,
            {u, other, bands_buffer_.get(), row_buffer_.get(), blocks_.get(), materials_.get(),
             node_sets_.get(), muscle_entries_.get(), muscle_sets_.get(), muscle_constants_.get(),
             shape_.get(), step_table_.get(), scratch_.get(), edge_.get()},
            {static_cast<std::int32_t>(bands_.n_bands()), bands_.n_planes, 0, step_reals_});
    } else {
      step_[parity] = make("element_forces_" + form,
                           {u, element_forces_.get(), blocks_.get(), materials_.get(),
                            muscle_entries_.get(), muscle_sets_.get(), muscle_constants_.get(),
                            shape_.get(), step_table_.get()},
                           {arrays_.n_blocks, 0, step_reals_});
      integrate_[parity] = make("integrate_nodes",
                                {u, other, element_forces_.get(), blocks_.get(), node_sets_.get(),
                                 step_table_.get()},
                                {arrays_.n_blocks, 0, step_reals_});
    }
  }
}

void Simulator::write_step_table(std::size_t n, const double* activations, bool forces_of_now) {
  const std::size_t n_muscles = model_.muscles.size();
  std::vector<double> table(n * step_reals_, 0.0);
  const double half_damping = options_.damping * dt_ / 2;
  for (std::size_t i = 0; i < n; ++i) {
    double* row = &table[i * step_reals_];
    row[STEP_VELOCITY] = (1 - half_damping) / (1 + half_damping);
    row[STEP_FORCE] = dt_ * dt_ / (1 + half_damping);
    // A given state has no u(-dt): u(dt) = u + v dt + (f/m - damping v) dt^2/2 keeps second order.
    if (i == 0 && starts_ && !forces_of_now) {
      row[STEP_VELOCITY] = 1 - half_damping;
      row[STEP_FORCE] = dt_ * dt_ / 2;
    }
    for (int c = 0; c < 3; ++c)
      row[STEP_GRAVITY + c] = model_.gravity[arrays_.order[c]] * row[STEP_FORCE];
    std::copy_n(activations + i * n_muscles, n_muscles, row + STEP_ACTIVATION);
  }
  write_reals(*step_table_, table);
}

void Simulator::step(std::size_t n, const std::vector<double>& activations) {
  const std::size_t n_muscles = model_.muscles.size();
  if (activations.size() != n * n_muscles)
    throw InputError("step: activations need " + std::to_string(n) + " x " +
                     std::to_string(n_muscles) + " values, got " +
                     std::to_string(activations.size()));
  if (!(dt_ > 0)) throw InputError("step: the time step is not set");
  const std::size_t n_slots = std::size_t(arrays_.n_blocks) * arrays_.lanes;
  for (std::size_t done = 0; done < n;) {
    const std::size_t batch = std::min(kBatch, n - done);
    device_->finish();  // the table may still be read by steps enqueued before
    write_step_table(batch, activations.data() + done * n_muscles, false);
    for (std::size_t i = 0; i < batch; ++i) {
      Kernel& kernel = *step_[now_];
      const auto index = static_cast<std::int32_t>(i);
      if (rows_) {
        kernel.set_arg(kRowsStepIndex, index);
        kernel.enqueue(bands_.n_bands(), 1);
      } else {
        kernel.set_arg(kElementsStepIndex, index);
        kernel.enqueue(n_slots, kGroup);
        integrate_[now_]->set_arg(kNodesStepIndex, index);
        integrate_[now_]->enqueue(n_slots, kGroup);
      }
      now_ = 1 - now_;
    }
    starts_ = false;
    done += batch;
    n_steps_ += static_cast<std::int64_t>(batch);
    time_ += dt_ * static_cast<double>(batch);
  }
}

std::vector<double> Simulator::read_slots(const Buffer& buffer) {
  const std::size_t count = std::size_t(arrays_.n_blocks + 1) * arrays_.lanes * 3;
  device_->finish();
  std::vector<double> slots(count);
  if (options_.precision == Precision::kDouble) {
    buffer.read(slots.data(), count * sizeof(double));
  } else {
    std::vector<float> narrow(count);
    buffer.read(narrow.data(), count * sizeof(float));
    std::copy(narrow.begin(), narrow.end(), slots.begin());
  }
  return slots;
}

std::vector<double> Simulator::displacement() { return slots_to_nodes(arrays_, read_slots(*u_[now_])); }

std::vector<double> Simulator::velocity() {
  const auto now = read_slots(*u_[now_]), before = read_slots(*u_[1 - now_]);
  std::vector<double> v(now.size());
  for (std::size_t i = 0; i < v.size(); ++i) v[i] = (now[i] - before[i]) / dt_;
  return slots_to_nodes(arrays_, v);
}

void Simulator::set_state(const std::vector<double>& u, const std::vector<double>& velocity,
                          double time) {
  const auto now = nodes_to_slots(arrays_, u);
  write_reals(*u_[now_], now);
  auto before = now;
  if (!velocity.empty()) {
    const auto v = nodes_to_slots(arrays_, velocity);
    for (std::size_t i = 0; i < before.size(); ++i) before[i] -= dt_ * v[i];
  }
  write_reals(*u_[1 - now_], before);
  time_ = time;
  n_steps_ = 0;
  starts_ = true;
}

void Simulator::set_dt(double dt) {
  if (!(dt > 0) || !std::isfinite(dt))
    throw InputError("dt: got " + std::to_string(dt) + ", allowed is a positive number of seconds");
  if (dt_ > 0 && dt != dt_) {
    const auto now = read_slots(*u_[now_]);
    auto before = read_slots(*u_[1 - now_]);
    for (std::size_t i = 0; i < now.size(); ++i)
      before[i] = now[i] - (now[i] - before[i]) * (dt / dt_);
    write_reals(*u_[1 - now_], before);
  }
  dt_ = dt;
}

TimeStepBound Simulator::bound_at_rest() const { return time_step_bound(model_, arrays_); }

TimeStepBound Simulator::bound_now() {
  return time_step_bound(model_, arrays_, evaluator().growth(displacement()));
}

StateEvaluator& Simulator::evaluator() {
  if (!evaluator_) evaluator_ = std::make_unique<StateEvaluator>(model_, precompute_);
  return *evaluator_;
}

std::vector<double> Simulator::internal_force(const std::vector<double>& activations) {
  if (activations.size() != model_.muscles.size())
    throw InputError("internal_force: one activation a muscle is needed");
  device_->finish();
  write_step_table(1, activations.data(), true);
  auto force = device_->allocate(u_[0]->bytes());
  const std::size_t n_slots = std::size_t(arrays_.n_blocks) * arrays_.lanes;
  if (rows_) {
    Kernel& kernel = *force_[now_];
    kernel.set_arg(1, *force);
    kernel.enqueue(bands_.n_bands(), 1);
    device_->finish();
    kernel.set_arg(1, *u_[1 - now_]);
  } else {
    step_[now_]->set_arg(kElementsStepIndex, std::int32_t(0));
    step_[now_]->enqueue(n_slots, kGroup);
    auto gather = program_->kernel("gather_forces");
    gather->set_arg(0, *force);
    gather->set_arg(1, *element_forces_);
    gather->set_arg(2, *blocks_);
    gather->set_arg(3, arrays_.n_blocks);
    gather->enqueue(n_slots, kGroup);
    device_->finish();
  }
  return slots_to_nodes(arrays_, read_slots(*force));
}

ElementState Simulator::element_state(const std::vector<double>& activations) {
  if (activations.size() != model_.muscles.size())
    throw InputError("element_state: one activation a muscle is needed");
  return evaluator().evaluate(displacement(), activations);
}

std::int64_t Simulator::first_non_finite_node() {
  const auto u = displacement();
  for (std::size_t i = 0; i < u.size(); ++i)
    if (!std::isfinite(u[i])) return static_cast<std::int64_t>(i / 3);
  return -1;
}

}  // namespace tledface
