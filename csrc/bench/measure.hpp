// The honest measurement: solver blocks in turns with roofline blocks on the same device, with the
// same threads, in one process; and whether the run that was timed is right.
#pragma once
#include <cstddef>
#include <functional>
#include <memory>
#include <string>

#include "bench/workloads.hpp"
#include "sim/simulator.hpp"

namespace tledface::bench {

struct MeasureOptions {
  SimulatorOptions simulator;
  // Makes the body with about so many elements; 0: with its own number. See workloads.hpp.
  std::function<Workload(std::size_t)> make;
  int rounds = 7;
  double block_seconds = 0.1;   // of each block of a round
  std::size_t block_steps = 0;  // of a solver's block; 0: as many as the seconds have room for
  // Of the two arrays that no cache holds, together; copies take as much.
  std::size_t array_bytes = std::size_t(512) << 20;
  bool checks = true;  // energy, float64; the repeat is always checked
};

// A JSON object; its keys are in bench/README.md. SimulationError where the state is not finite.
std::string measure(std::shared_ptr<Device> device, const MeasureOptions& options);

}  // namespace tledface::bench
