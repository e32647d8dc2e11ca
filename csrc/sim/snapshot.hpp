// A moment of a simulation on its way to the host, while the steps go on.
#pragma once
#include <cstdint>
#include <memory>
#include <vector>

#include "backend/device.hpp"
#include "sim/state_evaluator.hpp"

namespace tledface {

class Simulator;

// Holds on to its simulator, which must live longer. Its functions may be called in any thread, by
// one at a time, whatever the simulator does meanwhile.
class Snapshot {
 public:
  double time() const { return time_; }
  std::int64_t n_steps() const { return n_steps_; }  // shortest ones, since the last given state
  // These wait until the device has come so far.
  std::vector<double> displacement();  // 3 per node, m
  ElementState element_state();

 private:
  friend class Simulator;
  Snapshot(Simulator& sim, std::vector<double> activations);

  Simulator& sim_;
  std::vector<double> activations_;
  double time_, next_dt_;
  std::int64_t n_steps_;
  std::unique_ptr<Reading> u_, history_;  // the latter where laws have a past
};

}  // namespace tledface
