// tledface._core: the C++ core's Python face. Each bind file checks, converts and calls.
#include <pybind11/pybind11.h>

#include "core/error.hpp"

namespace py = pybind11;

void define_geometry(py::module_& module);
void define_model(py::module_& module);
void define_fibres(py::module_& module);
void define_devices(py::module_& module);
void define_kernel_choice(py::module_& module);
void define_simulator(py::module_& module);
void define_roofline(py::module_& module);

PYBIND11_MODULE(_core, module) {
  module.doc() = "C++ core of tledface";
  py::register_exception<tledface::InputError>(module, "InputError", PyExc_ValueError);
  py::register_exception<tledface::SimulationError>(module, "SimulationError", PyExc_RuntimeError);
  define_geometry(module);
  define_model(module);
  define_fibres(module);
  define_devices(module);
  define_kernel_choice(module);
  define_simulator(module);
  define_roofline(module);
}
