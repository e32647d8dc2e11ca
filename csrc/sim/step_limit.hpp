// The largest stable step under a deformation: the cheap bound of precompute/time_step.hpp, and
// a Lanczos iteration on the assembled operator that tightens it (the bound alone lies some 30 %
// below the limit). In float64 on the host whatever device runs the steps.
#pragma once
#include <memory>
#include <vector>

#include "precompute/time_step.hpp"

namespace tledface {

class Simulator;

struct StepLimit {
  TimeStepBound bound;    // the cheap one; it names the node and the element
  double dt = 0;          // estimate of the limit, s
  bool iterated = false;  // Lanczos was run for it
};

class StepLimiter {
 public:
  explicit StepLimiter(Simulator& sim);
  ~StepLimiter();

  // Estimate of the limit at displacement u, after the past of the simulator's laws (its rows as
  // Simulator::history gives them; empty without any). `reach_low`, `reach_high`: see
  // StiffnessState; they allow for what the fibres' stretch does until the next look. The iteration
  // is run again only when the estimate scaled from the last one is below `enough` (0: never;
  // infinite: always).
  //
  // Scaling: eigenvalues above the last estimate come from nodes whose own bound is above it;
  // while those have hardly grown, so has the operator. Constitutive laws beyond the
  // base stiffen in ways that the cheap bound does not know: with them the iteration decides alone
  // and is run each time.
  StepLimit limit(const std::vector<double>& u, const std::vector<double>& past,
                  StiffnessState state, double enough);

  // The same by an iteration of its own, which leaves no trace.
  StepLimit measure(const std::vector<double>& u, const std::vector<double>& past,
                    const StiffnessState& state);

  // omega^2 of each node's bound in the last call of limit(), what is to be reached included.
  const std::vector<double>& reached_squares() const { return reached_squares_; }

  // What the next answer depends on: omega^2 of each node's bound at the last iteration, and the
  // operator's then (0: none yet). For restarts bit for bit.
  const std::vector<double>& last_squares() const { return last_squares_; }
  double last_square() const { return last_square_; }
  void restore(std::vector<double> squares, double square);

 private:
  // Largest omega^2 of M^-1 K at u: Lanczos on finite differences of the forces, its largest Ritz
  // value plus the norm of that one's residual. K is that of a sudden change: viscous stresses have
  // no time to relax, and plastic tissue is elastic about its flow so far (a wave unloads it).
  double highest_square(const std::vector<double>& u, const std::vector<double>& past,
                        const std::vector<double>& activations,
                        const std::vector<double>& node_squares);
  // omega^2 of each node's bound, from node_stiffness; 0 where all components are held.
  std::vector<double> squares_of(const std::vector<double>& at_node) const;

  const VoxelModel& model_;
  const SolverArrays& given_;  // of the simulator; the host's may have other lanes
  std::vector<double> node_mass_;
  std::unique_ptr<Simulator> host_;
  const SolverArrays& arrays_;
  std::vector<double> last_squares_, reached_squares_;
  double last_square_ = 0;
};

}  // namespace tledface
