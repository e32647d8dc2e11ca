// Stress, deformation gradient and energies of every element, by the host's float64 kernel
// whatever device runs the steps: the same digits everywhere, and no device code for rare output.
#pragma once
#include <memory>
#include <mutex>
#include <vector>

#include "backend/device.hpp"
#include "precompute/solver_arrays.hpp"

namespace tledface {

struct ElementState {
  std::vector<double> deformation_gradient;  // 9 per element, row-major, model frame
  std::vector<double> stress;                // 6 per element, Cauchy, Pa: xx yy zz xy yz xz
  std::vector<double> energy_density;        // J/m3, without muscles
  std::vector<double> hourglass_density;     // J/m3
};

// Any thread may ask; they take turns.
class StateEvaluator {
 public:
  // given: the model's arrays with these options, taken where their lanes fit.
  StateEvaluator(const VoxelModel& model, PrecomputeOptions options,
                 std::shared_ptr<const SolverArrays> given);
  // history: rows in the layout of arrays() (see history_in_layout); dt, time: of the step that
  // comes.
  ElementState evaluate(const std::vector<double>& u, const std::vector<double>& activations,
                        const std::vector<double>& history = {}, double dt = 0, double time = 0);
  // Growth of the stiffness that bounds the step, per element (kernels_cl/state.cl); -1: inverted.
  const SolverArrays& arrays() const { return arrays_; }
  std::shared_ptr<const SolverArrays> shared_arrays() const { return shared_arrays_; }
  std::vector<double> growth(const std::vector<double>& u);

 private:
  std::unique_ptr<Buffer> upload(const void* data, std::size_t bytes);

  std::mutex mutex_;
  std::shared_ptr<Device> host_;
  std::shared_ptr<const SolverArrays> shared_arrays_;
  const SolverArrays& arrays_;
  bool physical_;
  std::unique_ptr<Program> program_;
  std::unique_ptr<Kernel> kernel_, growth_kernel_;
  std::unique_ptr<Buffer> u_, state_, growth_, step_, history_;
  std::vector<std::unique_ptr<Buffer>> constants_;
};

}  // namespace tledface
