// bench_solver [--workload NAME] [--elements N] [--device SPEC] [--hourglass physical|kappa]
//              [--kernels auto|rows|gather|tile] [--double] [--bands N] [--repeats R] [--steps N]
//              [--seconds S] [--no-checks] [--cells NX NY NZ] [--no-muscle] [--laws
//              sorted|scattered]
// What `tledface bench --workload` measures, without Python: prints one JSON object. For profilers,
// --repeats 1 --no-checks and many --steps leave little but steps. --cells, --no-muscle and
// --laws make a flat block of another size, without its muscle, and with a second law in half of
// its elements.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <initializer_list>
#include <string>

#include "bench/block_model.hpp"
#include "bench/measure.hpp"
#include "core/error.hpp"
#include "guarded.hpp"

using namespace tledface;

namespace {

int run(int argc, char** argv) {
  bench::MeasureOptions options;
  SimulatorOptions& simulator = options.simulator;
  std::string spec = "native", workload = "flat-block", laws;
  std::size_t elements = 0;
  int nx = 120, ny = 120, nz = 9;
  bool own_block = false, with_muscle = true;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const auto next = [&]() -> std::string {
      if (i + 1 >= argc) throw InputError(word + ": a value is missing");
      return argv[++i];
    };
    const auto whole = [&]() -> long {
      const std::string text = next();
      char* end = nullptr;
      const long value = std::strtol(text.c_str(), &end, 10);
      if (*end || value < 1)
        throw InputError(word + ": got '" + text + "', allowed is a whole number from 1");
      return value;
    };
    const auto one_of = [&](std::initializer_list<const char*> allowed) {
      const std::string text = next();
      std::string list;
      for (const char* name : allowed) {
        if (text == name) return text;
        list += (list.empty() ? "" : ", ") + std::string(name);
      }
      throw InputError(word + ": got '" + text + "', allowed are " + list);
    };
    if (word == "--workload")
      workload = next();
    else if (word == "--elements")
      elements = static_cast<std::size_t>(whole());
    else if (word == "--device")
      spec = next();
    else if (word == "--hourglass")
      simulator.hourglass = one_of({"physical", "kappa"}) == "kappa" ? HourglassForm::kKappa
                                                                     : HourglassForm::kPhysical;
    else if (word == "--kernels") {
      const std::string path = one_of({"auto", "rows", "gather", "tile"});
      simulator.kernels = path == "rows"     ? KernelPath::kRows
                          : path == "gather" ? KernelPath::kGather
                          : path == "tile"   ? KernelPath::kTile
                                             : KernelPath::kAuto;
    } else if (word == "--double")
      simulator.precision = Precision::kDouble;
    else if (word == "--bands")
      simulator.n_bands = static_cast<std::size_t>(whole());
    else if (word == "--repeats")
      options.rounds = static_cast<int>(whole());
    else if (word == "--steps")
      options.block_steps = static_cast<std::size_t>(whole());
    else if (word == "--seconds")
      options.block_seconds = std::atof(next().c_str());
    else if (word == "--no-checks")
      options.checks = false;
    else if (word == "--cells") {
      for (int* count : {&nx, &ny, &nz}) *count = static_cast<int>(whole());
      own_block = true;
    } else if (word == "--no-muscle") {
      with_muscle = false;
      own_block = true;
    } else if (word == "--laws") {
      laws = one_of({"sorted", "scattered"});
      own_block = true;
    } else
      throw InputError("unknown option '" + word + "'");
  }
  if (own_block) {
    options.make = [=](std::size_t wanted) {
      // Fewer elements: of the same thickness.
      const double share =
          wanted ? std::sqrt(std::min(1.0, double(wanted) / (double(nx) * ny * nz))) : 1;
      bench::Workload block;
      block.name = "flat-block " + std::to_string(nx) + "x" + std::to_string(ny) + "x" +
                   std::to_string(nz) + (laws.empty() ? "" : " " + laws);
      block.model = bench::flat_block(std::max(2, int(nx * share)), std::max(2, int(ny * share)),
                                      nz, with_muscle);
      if (!laws.empty()) bench::mix_laws(block.model, laws == "scattered");
      block.activation = with_muscle ? 0.3 : 0;
      return block;
    };
  } else {
    options.make = [=](std::size_t wanted) {
      return bench::make_workload(workload, wanted ? wanted : elements);
    };
  }
  std::printf("%s\n", bench::measure(open_device(spec), options).c_str());
  return 0;
}

}  // namespace

int main(int argc, char** argv) { return bench::guarded("bench_solver", &run, argc, argv); }
