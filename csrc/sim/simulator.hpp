// The step loop: buffers on a device, batches of explicit steps, state in and out. Knows nothing
// of materials' names, files or Python. All arrays at this border are float64 in the model's node
// and element order and frame.
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "backend/device.hpp"
#include "precompute/layout.hpp"
#include "precompute/solver_arrays.hpp"
#include "precompute/time_step.hpp"
#include "sim/device_checks.hpp"
#include "sim/force_path.hpp"
#include "sim/nodal_conditions.hpp"
#include "sim/sliding.hpp"
#include "sim/snapshot.hpp"
#include "sim/state_evaluator.hpp"
#include "sim/step_limit.hpp"
#include "sim/subcycling.hpp"

namespace tledface {

struct SimulatorOptions {
  Precision precision = Precision::kSingle;
  HourglassForm hourglass = HourglassForm::kPhysical;
  double kappa = 0.075;
  double damping = 0;  // mass-proportional, 1/s
  KernelPath kernels = KernelPath::kAuto;
  // Of the kernels of a step at most, see ProgramOptions; 0: tiles of float32 128, others as
  // compiled.
  int registers = 0;
  TileShape tile;                             // of kTile
  std::size_t n_bands = 0;                    // 0: by the device's compute units
  std::array<int, 3> axis_order{-1, -1, -1};  // see PrecomputeOptions
  // Whether runs of steps are recorded and replayed, where the device can; nothing: as chosen for
  // the device (kernel_choice.hpp), else launched one by one.
  std::optional<bool> recorded;
  // Arrays of the same model, form and axes that are there already; taken where their lanes fit.
  std::shared_ptr<const SolverArrays> arrays;
};

// Device arrays as they are (u now, u before), in the precision and block layout of the simulator
// that gave them, and the clock.
struct RawState {
  std::vector<std::uint8_t> u, u_prev, history;
  double clock_start = 0, dt = 0;
  std::int64_t clock_steps = 0, n_steps = 0;
  bool starts = true;
  // Of StepLimiter; a single 0, and 0, before its first iteration.
  std::vector<double> limit_squares;
  double limit_square = 0;
  // Of Sliding: what is known of the nodes' surfaces; empty: sought again, the same but for
  // rounding.
  std::vector<std::uint8_t> sliding;
  // Of subcycling: levels of each block's nodes, then of its elements; empty: u_prev is a shortest
  // step before u everywhere.
  std::vector<std::uint8_t> levels;
};

// What changes from step to step, for n steps.
struct StepInput {
  std::vector<double> activations;  // n x n_muscles, during each step
  std::vector<double> values;       // n x Simulator::n_values(): loads and pressures during each
                                    // step, prescribed values at its end,
                                    // then poses (Sliding::kPoseValues)
  std::vector<double> keys;         // of the fields, from key first_key() to key last_key(n)
};

// One step of a relaxation: u_next = u + velocity (u - u_prev) + force (f_ext - f_int)/mass.
struct RelaxationStep {
  double velocity, force;
  double field_weight;  // of the later of the two keys
};

class Simulator {
 public:
  // Prescribed components must be fixed in `model`: their 1/mass is 0.
  Simulator(std::shared_ptr<Device> device, VoxelModel model, const SimulatorOptions& options,
            Conditions conditions = {}, SlidingNodes sliding = {});
  ~Simulator();

  // Advances n steps of dt().
  void step(std::size_t n, const StepInput& input);
  // Keys of the fields stand at clock steps kFieldStride apart, whatever calls steps are dealt to.
  std::int64_t first_key() const { return (clock_steps_ + 1) / kFieldStride; }
  std::int64_t last_key(std::size_t n) const {
    return (clock_steps_ + static_cast<std::int64_t>(n)) / kFieldStride + 1;
  }
  double key_time(std::int64_t key) const {
    return clock_start_ + dt_ * static_cast<double>(key * kFieldStride);
  }
  // Overwrites prescribed components, at rest: `values` (n_prescribed), `fields` (n fields).
  void set_prescribed(const std::vector<double>& values, const std::vector<double>& fields);

  // Nodal masses with which the largest stable step is at least 1 under the deformation of now.
  std::vector<double> relaxation_masses();
  // Relaxation towards equilibrium: pseudo-steps with masses of its own (1 per node) that leave the
  // clock alone. input.keys: two keys. end: back to the masses of the model, at rest.
  void begin_relaxation(const std::vector<double>& node_mass);
  void relax(const std::vector<RelaxationStep>& steps, const StepInput& input);
  void end_relaxation();
  // The same body, state and conditions in float64, on this device where it has that, else on the
  // native one; and its displacement and past taken back. For what rounding would stop.
  std::unique_ptr<Simulator> in_double();
  void take_state(Simulator& other);

  // The shortest step. With subcycling() others are longer: steps are then taken in multiples of
  // substeps(), between which all is at one time.
  double dt() const { return dt_; }
  // Changes the step; the velocity is kept (u_prev is moved along it).
  void set_dt(double dt);
  bool can_subcycle() const { return path_->subcycles(); }
  std::int64_t substeps() const { return levels_.substeps(); }
  // 1, 2, 4, 8 or 16; everything takes the shortest step until choose_levels().
  void set_substeps(std::int64_t substeps);
  // Which step each block takes, by the bounds of the last limit_now(); the velocity is kept.
  void choose_levels();
  const BlockLevels& levels() const { return levels_; }
  // omega^2 of each node's bound in the last limit_now(), 1/s^2; empty before it.
  std::vector<double> node_squares() { return limiter().reached_squares(); }
  // Of each node: its step over the shortest.
  std::vector<std::int32_t> node_steps() const;
  // Bound at rest with each muscle's steepest slope.
  TimeStepBound bound_at_rest() const;
  // The limit under the deformation of now; see StepLimiter::limit.
  StepLimit limit_now(const FibreReach& reach, double enough);
  std::int64_t limit_iterations() const { return limiter_ ? limiter_->iterations() : 0; }
  StepLimit measured_limit(const std::vector<double>& activations);

  // Counted from the last change of dt: the same number however steps were dealt to calls.
  double time() const { return time_after(0); }
  double time_after(std::int64_t steps) const {
    return clock_start_ + dt_ * static_cast<double>(clock_steps_ + steps);
  }
  std::int64_t n_steps() const { return n_steps_; }
  bool starts() const { return starts_; }  // the next step is the first from a given state
  std::vector<double> displacement();      // 3 per node, m
  std::vector<double> velocity();          // 3 per node, m/s, of half a step ago
  // Starts again from these displacements at rest or with this velocity (empty: 0) at time `time`.
  void set_state(const std::vector<double>& u, const std::vector<double>& velocity, double time);
  // The whole state of the device, for a restart that continues bit for bit on the same kind of
  // device: restoring what was taken and stepping gives the bits of never having stopped.
  RawState raw_state();
  void set_raw_state(const RawState& state);
  std::vector<double> internal_force(const std::vector<double>& activations);  // N, 3 per node
  // The same, each element's times its step over the shortest: the impulses of subcycling.
  std::vector<double> weighted_force(const std::vector<double>& activations);
  // The past of laws that have one: their rows in the layout of arrays(); empty without any.
  std::vector<double> history();
  // Forces with a past (in the layout of arrays(); an empty one leaves what is there) as laws
  // answer to a change that is over at once: nothing relaxes, nothing flows. Their slope is the
  // largest stiffness. On a native device in float64, for many displacements in a row without
  // copies: write them to displacement_in_place(), [block][component][lane], over the state; the
  // forces stand likewise, until the next call.
  double* displacement_in_place() { return static_cast<double*>(u_[now_]->host_pointer()); }
  const double* instant_force_in_place(const std::vector<double>& past,
                                       const std::vector<double>& activations);
  // Loads, pressures and gravity, N, 3 per node.
  std::vector<double> external_force(const std::vector<double>& values);
  // Of the sliding nodes; see Sliding::normals and friction_losses.
  std::vector<double> sliding_normals() const {
    return sliding_ ? sliding_->normals() : std::vector<double>();
  }
  std::vector<double> friction_losses() const {
    return sliding_ ? sliding_->friction_losses() : std::vector<double>();
  }
  ElementState element_state(const std::vector<double>& activations);
  StateEvaluator& evaluator();
  // First node whose displacement is not finite, or -1.
  std::int64_t first_non_finite_node();
  // The state of now, with these activations, without waiting for it.
  std::unique_ptr<Snapshot> snapshot(const std::vector<double>& activations);
  // element_state() of a given moment: past as history() gives it, dt and time of the step that
  // comes. In any thread.
  ElementState element_state_at(const std::vector<double>& u, const std::vector<double>& past,
                                const std::vector<double>& activations, double dt, double time);

  const Device& device() const { return *device_; }
  const SolverArrays& arrays() const { return arrays_; }
  const VoxelModel& model() const { return model_; }
  const SimulatorOptions& options() const { return options_; }
  const Conditions& conditions() const { return conditions_->given(); }
  std::size_t n_pose_values() const { return sliding_given_.moving.size() * Sliding::kPoseValues; }
  std::size_t n_values() const { return n_condition_values() + n_pose_values(); }
  bool uses_rows() const { return rows_; }
  // Whether the kernels of a step put sliding nodes back themselves: nothing else acts on these.
  bool fuses_sliding() const { return fuses_sliding_ && levels_.n_levels == 1; }
  // "rows", "gather", "tile" or "hexahedra": what computes its steps.
  const char* kernels() const;
  // Device buffer of the displacement of now: [block][component][lane].
  const Buffer& displacement_buffer() const { return *u_[now_]; }
  const Buffer& history_buffer() const { return *history_[now_]; }
  // Whether runs of steps are recorded and replayed.
  bool records() const { return records_; }
  void finish() { device_->finish(); }
  std::size_t device_bytes() const { return device_bytes_; }

 private:
  std::size_t n_condition_values() const {
    return static_cast<std::size_t>(conditions_->given().n_values());
  }
  // Columns of the step table: activations, conditions, poses.
  std::int32_t pose_column() const {
    return static_cast<std::int32_t>(STEP_ACTIVATION + model_.muscles.size()) +
           NodalConditions::n_columns(conditions_->given());
  }
  std::unique_ptr<Buffer> upload(const std::vector<double>& values, std::size_t at_least = 1);
  std::unique_ptr<Buffer> upload(const std::vector<std::int32_t>& values);
  void write_reals(Buffer& buffer, const std::vector<double>& values);
  // Of the steps that are enqueued next; those before may still read the table as it was.
  void write_table(const std::vector<double>& rows);
  std::vector<double> read_reals(const Buffer& buffer, std::size_t count);
  std::vector<double> read_slots(const Buffer& buffer);
  void check_input(const char* what, std::size_t n, const StepInput& input,
                   std::size_t n_keys) const;
  // A row of the step table: what integrates, and the rest.
  void fill_motion(double* row, int highest_level, bool from_rest) const;
  void fill_step(double* row, const double* activations, const double* values,
                 FieldMoment field) const;
  // The row kernels' and conditions' part of a step from u[now]; highest_level: see ForcePath.
  void enqueue_step(int now, std::int32_t index, int highest_level);
  // Highest level that is due at a step of a batch: of all at the begin of a longest one.
  int highest_due(std::size_t step) const;
  // Steps `begin` to `end` of a batch, the first from u[now]; normals of sliding nodes are kept
  // from step `keep_from` on.
  void enqueue_steps(int now, std::size_t begin, std::size_t end, std::size_t keep_from);
  // The same of a whole run of steps whose normals are not kept, recorded when it is first asked
  // for; false where that cannot be done.
  bool replay_steps(std::size_t begin);
  // Arguments of the kernels change: what was recorded is no longer what is meant.
  void forget_recordings() { recordings_.clear(); }
  // Step of the node that real i of u belongs to, s.
  double step_of_real(std::size_t i) const {
    const std::size_t block = i / (std::size_t(3) * arrays_.lanes);
    return block < levels_.nodes.size() ? dt_ * double(1 << levels_.nodes[block]) : dt_;
  }
  // u before, moved to where it would be with these levels' steps; and the levels taken.
  void take_levels(BlockLevels levels);
  static std::size_t largest_batch();  // steps of one table
  SolverBuffers solver_buffers() const;
  // Which masses the kernels integrate with.
  void bind_masses(const Buffer& blocks, const Buffer& node_sets);
  std::vector<double> force_at(double dt, const std::vector<double>& activations,
                               bool weighted = false);
  void enqueue_force(double dt, const std::vector<double>& activations, Buffer& force,
                     bool weighted = false);
  StepLimiter& limiter();
  StateChecks& checks();
  RowShape row_shape() const { return {rows_, arrays_.lanes}; }
  void check_activations(const char* what, const std::vector<double>& activations) const;

  std::shared_ptr<Device> device_;
  VoxelModel model_;
  SimulatorOptions options_;
  PrecomputeOptions precompute_;
  std::shared_ptr<const SolverArrays> shared_arrays_;
  const SolverArrays& arrays_;
  bool rows_ = true, fuses_sliding_ = false;
  std::size_t device_bytes_ = 0;
  std::int32_t step_reals_ = 0;

  // The latter: where a limit of registers was asked for.
  std::unique_ptr<Program> program_, path_program_;
  std::unique_ptr<NodalConditions> conditions_;
  SlidingNodes sliding_given_;
  std::unique_ptr<Sliding> sliding_;  // where nodes slide
  // While one is going on: the masses, each block its own row set, and gravity as forces, since
  // its acceleration belongs to the true masses.
  struct Relaxation {
    std::unique_ptr<Buffer> blocks, node_sets;
    std::unique_ptr<NodalConditions> gravity;
  };
  std::unique_ptr<Relaxation> relaxation_;
  std::unique_ptr<Buffer> u_[2], blocks_, materials_, node_sets_, muscle_entries_, muscle_sets_,
      muscle_constants_, shape_, step_table_, law_entries_, law_sets_, history_[2];
  std::unique_ptr<Buffer> force_;  // of instant_force_in_place
  std::unique_ptr<ForcePath> path_;
  std::unique_ptr<StateEvaluator> evaluator_;  // these three are made when first asked for
  std::unique_ptr<StepLimiter> limiter_;
  std::unique_ptr<StateChecks> checks_;
  std::mutex evaluator_mutex_;  // while it is made, since snapshots ask in threads of their own
  int now_ = 0;
  BlockLevels levels_;
  bool records_ = false;
  std::map<std::pair<int, std::size_t>, std::unique_ptr<Recording>>
      recordings_;  // now_, first step

  double dt_ = 0, clock_start_ = 0;
  std::int64_t clock_steps_ = 0;  // since clock_start_
  std::int64_t n_steps_ = 0;
  bool starts_ = true;  // the next step starts from a given state
};

}  // namespace tledface
