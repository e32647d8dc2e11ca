// The parts of Simulator that step: rows of the step table, and batches of launches, one by one or
// as recordings of some steps each.
#include <algorithm>
#include <cmath>
#include <string>

#include "backend/launch_log.hpp"
#include "core/error.hpp"
#include "precompute/layout.hpp"
#include "sim/simulator.hpp"

namespace tledface {
namespace {

// Steps of one table of activations: long enough that writing it costs nothing.
constexpr std::size_t kBatch = 256;
// Steps that are recorded as one, where they are: an even number, so that each run begins with the
// same of the two displacement buffers, and of whole longest steps.
constexpr std::size_t kRun = 32;
static_assert(kRun % (std::size_t(1) << (TLED_MOST_LEVELS - 1)) == 0 && kBatch % kRun == 0);
}  // namespace

void Simulator::fill_step(double* row, const double* activations, const double* values,
                          FieldMoment field) const {
  row[STEP_UNIT] = 1;
  // A state that was just given has no past: histories start with it.
  row[STEP_DT] = starts_ ? 0 : dt_;
  row[STEP_TIME] = time();
  std::copy_n(activations, model_.muscles.size(), row + STEP_ACTIVATION);
  conditions_->fill_columns(values, field, row + STEP_ACTIVATION + model_.muscles.size());
  if (sliding_) sliding_->fill_poses(values + n_condition_values(), row + pose_column());
}

void Simulator::enqueue_step(int now, std::int32_t index, int highest_level) {
  path_->enqueue_step(now, index, highest_level);
  conditions_->enqueue(now, index);
}

int Simulator::highest_due(std::size_t step) const {
  int level = 0;
  while (level + 1 < levels_.n_levels && step % (std::size_t(2) << level) == 0) ++level;
  return level;
}

void Simulator::enqueue_steps(int now, std::size_t begin, std::size_t end, std::size_t keep_from) {
  for (std::size_t i = begin; i < end; ++i, now = 1 - now) {
    const auto index = static_cast<std::int32_t>(i);
    const int highest = highest_due(i);
    if (fuses_sliding()) {
      path_->enqueue_sliding_step(now, index);
      conditions_->enqueue(now, index);
      sliding_->enqueue_rest(1 - now, i >= keep_from);
    } else {
      enqueue_step(now, index, highest);
      if (sliding_) sliding_->enqueue(1 - now, index, i >= keep_from);
    }
    path_->enqueue_swap(highest);
  }
}

bool Simulator::replay_steps(std::size_t begin) {
  if (!records_ || active_launch_log()) return false;
  auto& recording = recordings_[{now_, begin}];
  if (!recording) {
    const std::size_t end = begin + kRun;
    recording = device_->record([&] { enqueue_steps(now_, begin, end, end); });
    records_ = recording != nullptr;
    if (!records_) return false;
  }
  recording->replay();
  return true;
}

std::size_t Simulator::largest_batch() { return kBatch; }

void Simulator::check_input(const char* what, std::size_t n, const StepInput& input,
                            std::size_t n_keys) const {
  const auto check = [&](const char* name, std::size_t got, std::size_t columns) {
    if (got != n * columns)
      throw InputError(std::string(what) + ": " + name + " need " + std::to_string(n) + " x " +
                       std::to_string(columns) + " values, got " + std::to_string(got));
  };
  check("activations", input.activations.size(), model_.muscles.size());
  check("values of conditions", input.values.size(), n_values());
  if (input.keys.size() != n_keys * conditions_->n_fields())
    throw InputError(std::string(what) + ": keys of fields need " +
                     std::to_string(n_keys * conditions_->n_fields()) + " values, got " +
                     std::to_string(input.keys.size()));
}

void Simulator::step(std::size_t n, const StepInput& input) {
  if (n == 0) return;
  const std::int64_t key_begin = first_key();
  check_input("step", n, input, static_cast<std::size_t>(last_key(n) - key_begin + 1));
  if (!(dt_ > 0)) throw InputError("step: the time step is not set");
  const auto substeps = static_cast<std::size_t>(this->substeps());
  if (n % substeps != 0)
    throw InputError("step: got " + std::to_string(n) + " of the shortest steps; allowed with " +
                     std::to_string(substeps) + " of them in the longest: multiples of that");
  const std::size_t n_muscles = model_.muscles.size(), n_values = this->n_values(),
                    n_fields = conditions_->n_fields();
  static_assert(kBatch % (std::size_t(1) << (TLED_MOST_LEVELS - 1)) == 0,
                "a batch ends with a longest step");
  std::vector<double> table;
  for (std::size_t done = 0; done < n;) {
    const std::size_t batch = std::min(kBatch, n - done);
    const std::int64_t key = first_key();
    table.assign(batch * step_reals_, 0.0);
    for (std::size_t i = 0; i < batch; ++i) {
      double* row = &table[i * step_reals_];
      const std::int64_t end = clock_steps_ + static_cast<std::int64_t>(i) + 1;
      fill_motion(row, highest_due(i), starts_ && i == 0);
      fill_step(row, input.activations.data() + (done + i) * n_muscles,
                input.values.data() + (done + i) * n_values,
                {end / kFieldStride - key, static_cast<double>(end % kFieldStride) / kFieldStride});
      row[STEP_DT] = starts_ && i == 0 ? 0 : dt_;
      row[STEP_TIME] = time_after(static_cast<std::int64_t>(i));
    }
    write_table(table);
    if (n_fields)
      conditions_->write_keys(
          input.keys.data() + static_cast<std::size_t>(key - key_begin) * n_fields,
          static_cast<std::size_t>(last_key(batch) - key + 1));
    // Normals are those of each node's last step.
    const std::size_t keep_from = n - std::min(n, done + substeps);
    for (std::size_t begin = 0; begin < batch; begin += kRun) {
      const std::size_t end = std::min(batch, begin + kRun);
      const bool whole = end - begin == kRun && (!sliding_ || end <= keep_from);
      if (!whole || !replay_steps(begin)) enqueue_steps(now_, begin, end, keep_from);
      if ((end - begin) % 2 == 1) now_ = 1 - now_;
    }
    starts_ = false;
    done += batch;
    n_steps_ += static_cast<std::int64_t>(batch);
    clock_steps_ += static_cast<std::int64_t>(batch);
  }
  device_->flush();
}

void Simulator::fill_motion(double* row, int highest_level, bool from_rest) const {
  for (int level = 0; level <= highest_level; ++level, row += TLED_STEP_LEVEL) {
    const double due = std::ldexp(1.0, level), dt = dt_ * due,
                 half_damping = options_.damping * dt / 2;
    row[STEP_DUE] = due;
    row[STEP_VELOCITY] = (1 - half_damping) / (1 + half_damping);
    row[STEP_FORCE] = dt_ * dt / (1 + half_damping);
    // A given state has no u(-dt): u(dt) = u + v dt + (f/m - damping v) dt^2/2 keeps second order.
    if (from_rest) {
      row[STEP_VELOCITY] = 1 - half_damping;
      row[STEP_FORCE] = dt_ * dt / 2;
    }
    for (int c = 0; c < 3; ++c)
      row[STEP_GRAVITY + c] = model_.gravity[arrays_.order[c]] * (row[STEP_FORCE] * due);
  }
}

}  // namespace tledface
