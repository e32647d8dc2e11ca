// What kernels='auto' means on a device.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>

#include "bindings/options.hpp"
#include "sim/kernel_choice.hpp"

namespace py = pybind11;
using namespace tledface;

void define_kernel_choice(py::module_& module) {
  module.def(
      "choose_kernels",
      [](const std::string& device, const std::string& precision, const std::string& hourglass,
         const std::string& kernels, const std::array<int, 3>& tile, int registers) {
        std::optional<KernelChoice> choice;
        if (const KernelPath path = pick_kernels(kernels); path != KernelPath::kAuto)
          choice = {path, make_tile(tile), registers};
        choose_kernels(device, pick_precision(precision), pick_hourglass(hourglass), choice);
      },
      py::arg("device"), py::arg("precision"), py::arg("hourglass"), py::kw_only(),
      py::arg("kernels"), py::arg("tile") = py::make_tuple(16, 8, 0), py::arg("registers") = 0,
      "What kernels='auto' means on a device from now on; 'auto': its own preference.");
  module.def("choose_recording", &choose_recording, py::arg("device"), py::arg("recorded"),
             "Whether runs of steps are recorded and replayed on a device from now on.");
}
