#include "bench/measure.hpp"

#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <vector>

#include "backend/launch_log.hpp"
#include "backend/roofline.hpp"
#include "bench/checks.hpp"
#include "bench/json.hpp"
#include "bench/workloads.hpp"
#include "core/bandwidth.hpp"
#include "core/error.hpp"
#include "core/threads.hpp"
#include "sim/operation_count.hpp"

namespace tledface::bench {
namespace {

using Clock = std::chrono::steady_clock;

// Above this a run is short, and what is counted or checked element by element is taken from a
// smaller body of the same make.
constexpr std::size_t kLarge = 2000000, kCountedElements = 130000;
constexpr std::size_t kCheckedSteps = 50, kFewSteps = 10, kProfiledSteps = 20;
// Steps of a block at most: contracted bodies that nobody damps or looks at go on for some thousand
// steps, then their step is too long. A GPU would be there within a second.
constexpr double kLongest = 250;
// Share of the largest energy that may be missing after the checked steps.
constexpr double kEnergyBound = 0.02;

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const std::size_t n = values.size();
  return n % 2 ? values[n / 2] : 0.5 * (values[n / 2 - 1] + values[n / 2]);
}

// Smallest and largest.
std::vector<double> range(const std::vector<double>& values) {
  const auto [low, high] = std::minmax_element(values.begin(), values.end());
  return {*low, *high};
}

double peak_memory_mb() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024;
}

double load_average() {
  double load = 0;
  return getloadavg(&load, 1) == 1 ? load : NAN;
}

std::string processor() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);)
    if (line.rfind("model name", 0) == 0) return line.substr(line.find(':') + 2);
  return "unknown";
}

// Bytes that an element step must move, with connectivity implied by the grid: a node's u and
// u_prev read, u_next written, 2 for its mass; an element's 2 for its material, 8 for muscle.
double bytes_floor(const VoxelModel& model, std::size_t muscle_elements, Precision precision) {
  const double n = static_cast<double>(model.n_elements());
  return (9 * double(real_size(precision)) + 2) * double(model.n_nodes()) / n + 2 +
         8 * double(muscle_elements) / n;
}

// What a round found.
struct Rounds {
  std::vector<double> axpy, axpy_large, arithmetic, copy, seconds, one_thread;
  std::vector<double> fraction, bytes_fraction, arithmetic_fraction, effective_bytes, thread_ratio,
      one_thread_fraction;
};

}  // namespace

std::string measure(std::shared_ptr<Device> device, const MeasureOptions& options) {
  const double load_before = load_average();
  auto begin = Clock::now();
  const Workload workload = options.make(0);
  const double model_seconds = seconds_since(begin);
  const std::size_t n_elements = workload.model.n_elements();
  const bool large = n_elements > kLarge;
  const auto n = static_cast<double>(n_elements);
  const std::size_t muscle_elements = workload.n_muscle_elements();

  begin = Clock::now();
  auto first = std::make_unique<Run>(device, workload, options.simulator);
  Run& run = *first;
  const double start_seconds = seconds_since(begin);
  Simulator& sim = run.simulator();

  // Two runs, the second with one thread where that can be had, bit for bit.
  const std::size_t checked = large ? kFewSteps : kCheckedSteps;
  run.advance(checked);
  const auto single = options.checks ? sim.displacement() : std::vector<double>();
  const bool repeatable = [&] {
    Run again(device, workload, options.simulator);
    limit_threads(1);
    again.advance(checked);
    again.finish();
    limit_threads(0);
    return again.simulator().raw_state().u == sim.raw_state().u;
  }();
  run.contract(large ? 3 * kFewSteps : Run::kRise);
  run.finish();

  const Workload counted =
      n_elements > kCountedElements ? options.make(kCountedElements) : workload;
  const auto counts =
      operations_per_element(counted.model, options.simulator.hourglass, sim.arrays().order);
  const InstructionMix mix{counts.fused, counts.multiplied, counts.added + counts.selected};
  const double instructions = mix.total() + counts.divided + counts.roots;
  const double bytes = bytes_floor(workload.model, muscle_elements, options.simulator.precision);

  // Arrays as large as the solver's own, up to what no cache holds.
  const std::size_t own_bytes = std::min(sim.device_bytes(), options.array_bytes);
  Roofline roofline(device, options.simulator.precision, own_bytes, mix);
  Roofline beyond(device, options.simulator.precision, options.array_bytes, mix);
  const bool on_host = device->info().kind == "native" || device->info().kind == "cpu";
  HostCopy host_copy(options.array_bytes / 2);
  const bool compare_threads = device->info().kind == "native" && thread_count() > 1;

  const double wanted = options.block_seconds;
  const auto solver_block = [&](std::size_t steps) {
    const auto from = Clock::now();
    run.advance(steps);
    run.finish();
    return seconds_since(from) / static_cast<double>(steps);
  };
  std::size_t steps = options.block_steps;
  if (steps == 0)
    steps = static_cast<std::size_t>(
        std::clamp(std::ceil(wanted / solver_block(large ? 1 : 10)), 1.0, large ? 50.0 : kLongest));
  Rounds r;
  for (int round = 0; round < options.rounds; ++round) {
    r.axpy.push_back(roofline.axpy(wanted));
    r.axpy_large.push_back(beyond.axpy(wanted));
    r.arithmetic.push_back(roofline.instructions(wanted));
    r.copy.push_back(on_host ? host_copy.measure() : beyond.copy(wanted));
    const double seconds = solver_block(steps);
    r.seconds.push_back(seconds);
    if (compare_threads) {
      limit_threads(1);
      r.one_thread.push_back(solver_block(std::max<std::size_t>(1, steps / 2)));
      const double bytes_time = bytes * n / (roofline.axpy(wanted) * 1e9),
                   arithmetic_time = instructions * n / (roofline.instructions(wanted) * 1e9);
      r.one_thread_fraction.push_back(std::max(bytes_time, arithmetic_time) / r.one_thread.back());
      limit_threads(0);
      r.thread_ratio.push_back(r.one_thread.back() / seconds);
    }
    const double bytes_time = bytes * n / (r.axpy.back() * 1e9),
                 arithmetic_time = instructions * n / (r.arithmetic.back() * 1e9);
    r.bytes_fraction.push_back(bytes_time / seconds);
    r.arithmetic_fraction.push_back(arithmetic_time / seconds);
    r.fraction.push_back(std::max(bytes_time, arithmetic_time) / seconds);
    r.effective_bytes.push_back(r.copy.back() * 1e9 * seconds / n);
  }

  LaunchLog log;
  const std::size_t profiled = large ? 3 : kProfiledSteps;
  active_launch_log() = &log;
  try {
    run.advance(profiled);
  } catch (...) {
    active_launch_log() = nullptr;
    throw;
  }
  active_launch_log() = nullptr;
  if (sim.first_non_finite_node() >= 0)
    throw SimulationError("bench " + workload.name +
                          ": the state is not finite, the speed means nothing");
  Json per_kernel;
  std::size_t launches = 0;
  for (const auto& [name, entry] : log.kernels) {
    launches += entry.launches;
    per_kernel.add(name, Json()
                             .add("launches", double(entry.launches) / double(profiled))
                             .add("ms", entry.seconds / double(profiled) * 1e3));
  }

  const double seconds = median(r.seconds);
  const auto& info = device->info();
  Json result;
  result.add("device", info.name)
      .add("platform", info.platform)
      .add("driver", info.driver)
      .add("processor", processor())
      .add("threads", thread_count())
      .add("load_average", std::vector<double>{load_before, load_average()})
      .add("workload", workload.name)
      .add("elements", n_elements)
      .add("nodes", workload.model.n_nodes())
      .add("muscle_elements", muscle_elements)
      .add("sliding_nodes", workload.sliding.nodes.size())
      .add("precision", options.simulator.precision == Precision::kSingle ? "single" : "double")
      .add("hourglass",
           options.simulator.hourglass == HourglassForm::kPhysical ? "physical" : "joldes")
      .add("kernels", sim.kernels())
      .add("command_buffers", sim.records())
      .add("lanes", sim.arrays().lanes)
      .add("fill", sim.arrays().fill())
      .add("dt", sim.dt())
      .add("model_s", model_seconds)
      .add("start_s", start_seconds)
      .add("device_mb", double(sim.device_bytes()) / (1 << 20))
      .add("rounds", r.seconds.size())
      .add("steps_a_block", steps)
      .add("ms_per_step", seconds * 1e3)
      .add("spread", range(r.seconds)[1] / range(r.seconds)[0])
      .add("melem_steps_per_s", n / seconds / 1e6)
      .add("copy_gb_s", median(r.copy))
      .add("axpy_gb_s", median(r.axpy))
      .add("axpy_beyond_caches_gb_s", median(r.axpy_large))
      .add("arithmetic_g_s", median(r.arithmetic))
      .add("effective_bytes", median(r.effective_bytes))
      .add("effective_bytes_range", range(r.effective_bytes))
      .add("floor_bytes", bytes)
      .add("floor_instructions", instructions)
      .add("instructions", Json()
                               .add("fused", counts.fused)
                               .add("multiplied", counts.multiplied)
                               .add("added", counts.added)
                               .add("selected", counts.selected)
                               .add("divided", counts.divided)
                               .add("roots", counts.roots)
                               .add("shuffled", counts.shuffled))
      .add("bytes_fraction", median(r.bytes_fraction))
      .add("bytes_fraction_range", range(r.bytes_fraction))
      .add("arithmetic_fraction", median(r.arithmetic_fraction))
      .add("arithmetic_fraction_range", range(r.arithmetic_fraction))
      .add("roofline_fraction", median(r.fraction))
      .add("roofline_fraction_range", range(r.fraction));
  if (compare_threads)
    result.add("one_thread_ms_per_step", median(r.one_thread) * 1e3)
        .add("one_thread_roofline_fraction", median(r.one_thread_fraction))
        .add("one_thread_roofline_fraction_range", range(r.one_thread_fraction))
        .add("thread_ratio", median(r.thread_ratio))
        .add("thread_ratio_range", range(r.thread_ratio));
  result.add("launches_per_step", double(launches) / double(profiled))
      .add("per_kernel", per_kernel)
      .add("bitwise_repeatable", repeatable);
  first.reset();  // large ones leave no room for another
  if (options.checks) {
    const auto energy = energy_balance(device, counted, options.simulator);
    if (!std::isfinite(energy.error))
      throw SimulationError("bench " + workload.name + ": the energy is not finite");
    result.add("float64_error", float64_error(device, workload, options.simulator, checked, single))
        .add("float64_steps", checked)
        .add("energy", Json()
                           .add("elements", energy.elements)
                           .add("steps", energy.steps)
                           .add("kinetic", energy.kinetic)
                           .add("strain", energy.strain)
                           .add("hourglass", energy.hourglass)
                           .add("muscle_work", energy.muscle_work)
                           .add("external", energy.external)
                           .add("error", energy.error)
                           .add("bound", kEnergyBound)
                           .add("holds", std::abs(energy.error) <= kEnergyBound));
  }
  result.add("peak_memory_mb", peak_memory_mb());
  return result.text();
}

}  // namespace tledface::bench
