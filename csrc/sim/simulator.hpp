// The step loop: buffers on a device, batches of explicit steps, state in and out. Knows nothing
// of materials' names, files or Python. All arrays at this border are float64 in the model's node
// and element order and frame.
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "backend/device.hpp"
#include "precompute/solver_arrays.hpp"
#include "precompute/time_step.hpp"
#include "sim/state_evaluator.hpp"

namespace tledface {

enum class KernelPath { kAuto, kRows, kGather };

struct SimulatorOptions {
  Precision precision = Precision::kSingle;
  HourglassForm hourglass = HourglassForm::kPhysical;
  double kappa = 0.075;
  double damping = 0;       // mass-proportional, 1/s
  double mass_scaling = 1;
  KernelPath kernels = KernelPath::kAuto;
  std::size_t n_bands = 0;  // 0: by the device's compute units
};

class Simulator {
 public:
  Simulator(std::shared_ptr<Device> device, VoxelModel model, const SimulatorOptions& options);
  ~Simulator();

  // Advances n steps of dt(). activations: n x n_muscles, the values during each step.
  void step(std::size_t n, const std::vector<double>& activations);

  double dt() const { return dt_; }
  // Changes the step; the velocity is kept (u_prev is moved along it).
  void set_dt(double dt);
  // Bound at rest, or with the deformation of now.
  TimeStepBound bound_at_rest() const;
  TimeStepBound bound_now();

  double time() const { return time_; }
  std::int64_t n_steps() const { return n_steps_; }
  std::vector<double> displacement();  // 3 per node, m
  std::vector<double> velocity();      // 3 per node, m/s, of half a step ago
  // Starts again from these displacements at rest or with this velocity (empty: 0) at time `time`.
  void set_state(const std::vector<double>& u, const std::vector<double>& velocity, double time);
  std::vector<double> internal_force(const std::vector<double>& activations);  // N, 3 per node
  ElementState element_state(const std::vector<double>& activations);
  // First node whose displacement is not finite, or -1.
  std::int64_t first_non_finite_node();

  const Device& device() const { return *device_; }
  const SolverArrays& arrays() const { return arrays_; }
  const VoxelModel& model() const { return model_; }
  const SimulatorOptions& options() const { return options_; }
  bool uses_rows() const { return rows_; }
  // Device buffer of the displacement of now: [block][component][lane].
  const Buffer& displacement_buffer() const { return *u_[now_]; }
  void finish() { device_->finish(); }
  std::size_t device_bytes() const { return device_bytes_; }

 private:
  std::unique_ptr<Buffer> upload(const std::vector<double>& values, std::size_t at_least = 1);
  std::unique_ptr<Buffer> upload(const std::vector<std::int32_t>& values);
  void write_reals(Buffer& buffer, const std::vector<double>& values);
  std::vector<double> read_slots(const Buffer& buffer);
  void write_step_table(std::size_t n, const double* activations, bool forces_of_now);
  void bind();
  StateEvaluator& evaluator();

  std::shared_ptr<Device> device_;
  VoxelModel model_;
  SimulatorOptions options_;
  PrecomputeOptions precompute_;
  SolverArrays arrays_;
  bool rows_ = true;
  RowBands bands_;
  std::size_t device_bytes_ = 0;
  std::int32_t step_reals_ = 0;

  std::unique_ptr<Program> program_;
  std::unique_ptr<Buffer> u_[2], blocks_, bands_buffer_, row_buffer_, materials_, node_sets_,
      muscle_entries_, muscle_sets_, muscle_constants_, shape_, step_table_, scratch_, edge_,
      element_forces_;
  std::unique_ptr<Kernel> step_[2], integrate_[2], force_[2];
  std::unique_ptr<StateEvaluator> evaluator_;  // made when first asked for
  int now_ = 0;

  double dt_ = 0, time_ = 0;
  std::int64_t n_steps_ = 0;
  bool starts_ = true;  // the next step starts from a given state
};

}  // namespace tledface
