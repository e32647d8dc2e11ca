// bench_solver [--device SPEC] [--cells NX NY NZ] [--steps N] [--hourglass physical|kappa]
//              [--kernels auto|rows|gather] [--double] [--no-muscle] [--laws sorted|scattered]
//              [--repeats R]
// Steps a contracting skin block and prints one JSON object: speed beside the copy bandwidth of
// the same run. The state is a realistic one: the muscle is contracted before the clock starts.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "block_model.hpp"
#include "core/bandwidth.hpp"
#include "core/error.hpp"
#include "core/threads.hpp"
#include "sim/simulator.hpp"

using namespace tledface;
using Clock = std::chrono::steady_clock;

namespace {

double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

int run(int argc, char** argv) {
  int nx = 120, ny = 120, nz = 9, steps = 300, repeats = 5;
  bool with_muscle = true;
  std::string laws;
  std::string spec = "native";
  SimulatorOptions options;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const auto next = [&]() -> std::string {
      if (i + 1 >= argc) throw InputError(word + ": a value is missing");
      return argv[++i];
    };
    if (word == "--device")
      spec = next();
    else if (word == "--cells")
      nx = std::stoi(next()), ny = std::stoi(next()), nz = std::stoi(next());
    else if (word == "--steps")
      steps = std::stoi(next());
    else if (word == "--repeats")
      repeats = std::stoi(next());
    else if (word == "--hourglass")
      options.hourglass = next() == "kappa" ? HourglassForm::kKappa : HourglassForm::kPhysical;
    else if (word == "--kernels") {
      const auto k = next();
      options.kernels = k == "rows"     ? KernelPath::kRows
                        : k == "gather" ? KernelPath::kGather
                                        : KernelPath::kAuto;
    } else if (word == "--bands")
      options.n_bands = std::stoul(next());
    else if (word == "--laws")
      laws = next();
    else if (word == "--double")
      options.precision = Precision::kDouble;
    else if (word == "--no-muscle")
      with_muscle = false;
    else
      throw InputError("bench_solver: unknown option '" + word + "'");
  }
  auto model = bench::flat_block(nx, ny, nz, with_muscle);
  if (!laws.empty()) bench::mix_laws(model, laws == "scattered");
  const double n_elements = static_cast<double>(model.n_elements());
  auto device = open_device(spec);
  Simulator sim(device, std::move(model), options);
  sim.set_dt(0.8 * sim.bound_at_rest().dt);
  const std::size_t n_muscles = sim.model().muscles.size();
  const auto advance = [&](int n) {
    sim.step(n, {std::vector<double>(std::size_t(n) * n_muscles, 0.3), {}, {}});
    sim.finish();
  };
  advance(200);
  double best = 1e30;
  for (int repeat = 0; repeat < repeats; ++repeat) {
    const auto begin = Clock::now();
    advance(steps);
    best = std::min(best, seconds_since(begin) / steps);
  }
  const double copy = copy_bandwidth();
  if (sim.first_non_finite_node() >= 0) throw SimulationError("the state is not finite");
  std::printf(
      "{\"device\": \"%s\", \"workload\": \"flat-block %dx%dx%d%s\", \"elements\": %.0f, "
      "\"precision\": \"%s\", \"hourglass\": \"%s\", \"kernels\": \"%s\", \"fill\": %.3f, "
      "\"ms_per_step\": %.4f, \"melem_steps_per_s\": %.1f, \"copy_gb_s\": %.1f, "
      "\"effective_bytes\": %.1f, \"threads\": %zu}\n",
      device->info().name.c_str(), nx, ny, nz, with_muscle ? " muscle" : "", n_elements,
      options.precision == Precision::kSingle ? "single" : "double",
      options.hourglass == HourglassForm::kPhysical ? "physical" : "kappa",
      sim.uses_rows() ? "rows" : "gather", sim.arrays().fill(), best * 1e3, n_elements / best / 1e6,
      copy, copy * 1e9 * best / n_elements, thread_count());
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const InputError& error) {
    std::fprintf(stderr, "bench_solver: error: %s\n", error.what());
    return 2;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_solver: error: %s\n", error.what());
    return 1;
  }
}
