// What a device can do at best and what a step asks of it, for Python's benchmark.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <map>
#include <string>
#include <utility>

#include "backend/roofline.hpp"
#include "bench/measure.hpp"
#include "bench/workloads.hpp"
#include "bindings/arrays.hpp"
#include "bindings/options.hpp"
#include "core/error.hpp"
#include "sim/operation_count.hpp"

namespace py = pybind11;

void define_roofline(py::module_& module) {
  using namespace tledface;
  using ReleaseGil = py::call_guard<py::gil_scoped_release>;

  py::class_<Roofline>(module, "Roofline", "Plain memory traffic and arithmetic on a device.")
      .def(py::init([](std::shared_ptr<Device> device, bool is_double, std::size_t nbytes,
                       double fused, double multiplied, double added) {
             return std::make_unique<Roofline>(std::move(device),
                                               is_double ? Precision::kDouble : Precision::kSingle,
                                               nbytes, InstructionMix{fused, multiplied, added});
           }),
           py::arg("device"), py::kw_only(), py::arg("is_double"), py::arg("nbytes"),
           py::arg("fused"), py::arg("multiplied"), py::arg("added"))
      .def("axpy", &Roofline::axpy, py::arg("seconds"), ReleaseGil(),
           "GB/s of y += a x, 3 reals an element, in a block of so many seconds.")
      .def("copy", &Roofline::copy, py::arg("seconds"), ReleaseGil(),
           "GB/s of y = x, 2 reals an element.")
      .def("instructions", &Roofline::instructions, py::arg("seconds"), ReleaseGil(),
           "G instructions a second, each on one real, of the mix.")
      .def_property_readonly(
          "mix",
          [](const Roofline& roofline) {
            const auto& mix = roofline.mix();
            return py::make_tuple(mix.fused, mix.multiplied, mix.added);
          },
          "Multiply-adds, products and sums of the kernel: the nearest that it can do.");

  module.def(
      "operations_per_element",
      [](const VoxelModel& model, bool physical, std::array<int, 3> axis_order) {
        const auto counts = [&] {
          py::gil_scoped_release release;
          return operations_per_element(
              model, physical ? HourglassForm::kPhysical : HourglassForm::kKappa, axis_order);
        }();
        return std::map<std::string, double>{
            {"fused", counts.fused},       {"multiplied", counts.multiplied},
            {"added", counts.added},       {"selected", counts.selected},
            {"divided", counts.divided},   {"roots", counts.roots},
            {"shuffled", counts.shuffled},
        };
      },
      py::arg("model"), py::kw_only(), py::arg("physical"), py::arg("axis_order"),
      "Vector instructions of one step of the row kernels by kind, per element: the kernels' own "
      "text, counted as it runs.");

  using bench::Workload;
  py::class_<Workload>(module, "Workload", "A body that the benchmark steps, in the core's frame.")
      .def(py::init(&bench::make_workload), py::arg("name"), py::arg("elements") = 0, ReleaseGil())
      .def_readonly("model", &Workload::model)
      .def_readonly("sliding", &Workload::sliding)
      .def_readonly("speed", &Workload::speed, "m a step along y, at which it is thrown.")
      .def_property_readonly("n_elements", [](const Workload& w) { return w.model.n_elements(); })
      .def_property_readonly("n_nodes", [](const Workload& w) { return w.model.n_nodes(); })
      .def_property_readonly("n_muscle_elements", &Workload::n_muscle_elements)
      .def_property_readonly(
          "sliding_nodes",
          [](const Workload& w) { return to_array(std::vector<std::int64_t>(w.sliding.nodes)); })
      .def_property_readonly("sliding_distances", [](const Workload& w) {
        return to_array(std::vector<double>(w.sliding.distance));
      });

  module.def("workload_names", &bench::workload_names, "What bench_measure knows.");
  module.def("workload_elements", &bench::workload_elements, py::arg("workload"),
             "Its number of elements.");
  module.def(
      "bench_measure",
      [](std::shared_ptr<Device> device, const std::string& workload, std::size_t elements,
         bool physical, bool is_double, const std::string& kernels, int rounds, double seconds,
         bool checks, std::size_t array_bytes) {
        bench::MeasureOptions options;
        options.make = [=](std::size_t wanted) {
          return bench::make_workload(workload, wanted ? wanted : elements);
        };
        options.simulator.hourglass = physical ? HourglassForm::kPhysical : HourglassForm::kKappa;
        options.simulator.precision = is_double ? Precision::kDouble : Precision::kSingle;
        options.simulator.kernels = pick_kernels(kernels);
        options.rounds = rounds;
        options.block_seconds = seconds;
        options.checks = checks;
        options.array_bytes = array_bytes;
        return bench::measure(std::move(device), options);
      },
      py::arg("device"), py::arg("workload"), py::kw_only(), py::arg("elements") = 0,
      py::arg("physical") = true, py::arg("is_double") = false, py::arg("kernels") = "auto",
      py::arg("rounds") = 7, py::arg("seconds") = 0.1, py::arg("checks") = true,
      py::arg("array_bytes") = std::size_t(512) << 20, ReleaseGil(),
      "Times a workload beside the roofline and checks the run; a JSON object.");
}
