// What makes a measured speed mean something: the same run is right, repeats, and keeps its energy.
#pragma once
#include <memory>

#include "bench/workloads.hpp"
#include "sim/simulator.hpp"

namespace tledface::bench {

// A workload under way: thrown along y, its muscles rising to their activation over kRise steps.
class Run {
 public:
  static constexpr int kRise = 400;
  Run(std::shared_ptr<Device> device, const Workload& workload, const SimulatorOptions& options);

  void restart();
  void advance(std::size_t n);
  void contract(std::size_t n);  // the rise ends n steps from now
  void finish() { sim_.finish(); }
  Simulator& simulator() { return sim_; }
  std::vector<double> activations() const;  // of the step that comes

 private:
  double level(std::size_t step) const;
  Simulator sim_;
  double speed_, activation_;
  std::size_t steps_ = 0, full_at_ = kRise;
};

struct EnergyBalance {
  std::size_t elements = 0;
  int steps = 0;
  double kinetic = 0, strain = 0, hourglass = 0, muscle_work = 0, external = 0;  // J, at the end
  double error = 0;  // what does not add up, over the largest energy that was there
};

// Entered every few steps in float64: kinetic + strain + hourglass - work since the first entry.
EnergyBalance energy_balance(std::shared_ptr<Device> device, const Workload& workload,
                             const SimulatorOptions& options);

// Largest difference of the displacements in single and double precision after some steps, over the
// largest displacement.
double float64_error(std::shared_ptr<Device> device, const Workload& workload,
                     const SimulatorOptions& options, std::size_t n_steps,
                     const std::vector<double>& single);

}  // namespace tledface::bench
