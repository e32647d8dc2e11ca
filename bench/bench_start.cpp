// bench_start [--workload NAME] [--elements N] [--repeats R]
// From a model in memory to the first step: solver arrays, buffers and kernels (`simulator_s`), and
// the time step's limit at rest (`limit_s`), each the best of the repeats; prints one JSON object.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>

#include "bench/json.hpp"
#include "bench/workloads.hpp"
#include "core/error.hpp"
#include "core/threads.hpp"
#include "guarded.hpp"
#include "sim/simulator.hpp"

using namespace tledface;

namespace {

using Clock = std::chrono::steady_clock;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

int run(int argc, char** argv) {
  std::string name = "face";
  std::size_t elements = 0;
  int repeats = 3;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    if (i + 1 >= argc) throw InputError(word + ": a value is missing");
    const std::string value = argv[++i];
    if (word == "--workload")
      name = value;
    else if (word == "--elements")
      elements = static_cast<std::size_t>(std::strtoul(value.c_str(), nullptr, 10));
    else if (word == "--repeats")
      repeats = std::max(1, std::atoi(value.c_str()));
    else
      throw InputError("unknown option '" + word + "'");
  }
  const auto workload = bench::make_workload(name, elements);
  double arrays_s = HUGE_VAL, simulator_s = HUGE_VAL, limit_s = HUGE_VAL, dt = 0;
  for (int repeat = 0; repeat < repeats; ++repeat) {
    auto begin = Clock::now();
    auto device = open_device("native");
    PrecomputeOptions options;
    options.lanes = device->preferred_lanes(Precision::kSingle);
    make_solver_arrays(workload.model, options);
    arrays_s = std::min(arrays_s, seconds_since(begin));
    begin = Clock::now();
    Simulator sim(device, workload.model, SimulatorOptions(), {}, workload.sliding);
    simulator_s = std::min(simulator_s, seconds_since(begin));
    begin = Clock::now();
    const std::vector<double> rest(workload.model.muscles.size(), 0.0);
    dt = sim.limit_now({rest}, HUGE_VAL).dt;
    limit_s = std::min(limit_s, seconds_since(begin));
  }
  bench::Json result;
  result.add("workload", name)
      .add("elements", workload.model.n_elements())
      .add("nodes", workload.model.n_nodes())
      .add("sliding_nodes", workload.sliding.nodes.size())
      .add("threads", thread_count())
      .add("arrays_s", arrays_s)
      .add("simulator_s", simulator_s)
      .add("limit_s", limit_s)
      .add("ready_s", simulator_s + limit_s)
      .add("limit", dt);
  std::printf("%s\n", result.text().c_str());
  return 0;
}

}  // namespace

int main(int argc, char** argv) { return bench::guarded("bench_start", &run, argc, argv); }
