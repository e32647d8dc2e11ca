// The largest stable step under a deformation: the cheap bound of nodes, found on the device
// (step_bounds.hpp), and a Lanczos iteration on the assembled operator that tightens it (the bound
// alone lies some 30 % below the limit), in float64 on the host whatever device runs the steps.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "precompute/time_step.hpp"
#include "sim/step_bounds.hpp"

namespace tledface {

class Simulator;

struct StepLimit {
  TimeStepBound bound;    // the cheap one; it names the node and the element
  double dt = 0;          // estimate of the limit, s
  bool iterated = false;  // Lanczos was run for it
};

class StepLimiter {
 public:
  // sim: lives longer.
  StepLimiter(Simulator& sim, std::unique_ptr<StepBounds> bounds);
  ~StepLimiter();

  // Estimate of the limit at the displacement of now, after the past of the simulator's laws.
  // `reach` allows for what the fibres' stretch does until the next look. The iteration is run
  // again only when the estimate scaled from the last one is below `enough` (0: never; infinite:
  // always).
  //
  // Scaling: eigenvalues above the last estimate come from nodes whose own bound is above it;
  // while those have hardly grown, so has the operator. Constitutive laws beyond the
  // base stiffen in ways that the cheap bound does not know: with them the iteration decides alone
  // and is run each time.
  StepLimit limit(const FibreReach& reach, double enough);

  // The same by an iteration of its own, which leaves no trace.
  StepLimit measure(const std::vector<double>& activations);

  // omega^2 of each node's bound in the last call of limit(), what is to be reached included.
  std::vector<double> reached_squares() const { return bounds_->reached_squares(); }

  // What the next answer depends on: omega^2 of each node's bound at the last iteration, and the
  // operator's then (0: none yet). For restarts bit for bit.
  std::vector<double> last_squares() const;
  // How often the iteration was run.
  std::int64_t iterations() const { return iterations_; }
  double last_square() const { return last_square_; }
  void restore(const std::vector<double>& squares, double square);

  std::size_t bytes() const { return bounds_->bytes(); }

 private:
  // Largest omega^2 of M^-1 K at the state of now: Lanczos on finite differences of the forces, its
  // largest Ritz value plus the norm of that one's residual. K is that of a sudden change: viscous
  // stresses have no time to relax, and plastic tissue is elastic about its flow so far (a wave
  // unloads it). Its start is made from the squares that bounds_ has.
  double highest_square(const std::vector<double>& activations);

  Simulator& sim_;
  const VoxelModel& model_;
  const SolverArrays& given_;  // of the simulator; the host's may have other lanes
  std::vector<double> node_mass_;
  std::unique_ptr<StepBounds> bounds_;
  std::unique_ptr<Simulator> host_;
  const SolverArrays& arrays_;
  double last_square_ = 0;
  std::int64_t iterations_ = 0;
};

}  // namespace tledface
