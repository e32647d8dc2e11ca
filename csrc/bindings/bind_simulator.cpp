// Simulator: arrays in and out in the model's node and element order, float64.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "core/bandwidth.hpp"
#include "core/error.hpp"
#include "sim/simulator.hpp"

namespace py = pybind11;
using namespace tledface;

namespace {

template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;

template <class T>
std::vector<T> to_vector(const Array<T>& array) {
  return std::vector<T>(array.data(), array.data() + array.size());
}

// Shapes (n,) or (n, columns); hands the vector's memory over without a copy.
template <class T>
py::array_t<T> to_array(std::vector<T>&& values, py::ssize_t columns = 0) {
  auto* kept = new std::vector<T>(std::move(values));
  py::capsule owner(kept, [](void* pointer) { delete static_cast<std::vector<T>*>(pointer); });
  const auto size = static_cast<py::ssize_t>(kept->size());
  std::vector<py::ssize_t> shape =
      columns ? std::vector<py::ssize_t>{size / columns, columns} : std::vector<py::ssize_t>{size};
  return py::array_t<T>(shape, kept->data(), owner);
}

VoxelModel make_model(std::array<double, 3> voxel, const Array<std::int32_t>& cells,
                      const Array<std::int32_t>& node_ijk, const Array<double>& mu,
                      const Array<double>& bulk_log, const Array<double>& bulk_quadratic,
                      const Array<double>& density, const Array<double>& bending_modulus,
                      const Array<std::uint8_t>& fixed, std::array<double, 3> gravity) {
  VoxelModel model;
  model.voxel = voxel;
  model.cells = to_vector(cells);
  model.node_ijk = to_vector(node_ijk);
  model.mu = to_vector(mu);
  model.bulk_log = to_vector(bulk_log);
  model.bulk_quadratic = to_vector(bulk_quadratic);
  model.density = to_vector(density);
  model.bending_modulus = to_vector(bending_modulus);
  model.fixed = to_vector(fixed);
  model.gravity = gravity;
  return model;
}

void add_muscle(VoxelModel& model, const std::string& name, const Array<std::int64_t>& elements,
                const Array<double>& fibre, const Array<double>& weight, double sigma_act,
                double sigma_pas, double lambda_opt, double lambda_pas, bool printed_passive) {
  if (fibre.size() != 3 * elements.size() || weight.size() != elements.size())
    throw InputError("muscle '" + name + "': elements, fibre and weight differ in length");
  model.muscles.push_back({name, to_vector(elements), to_vector(fibre), to_vector(weight),
                           sigma_act, sigma_pas, lambda_opt, lambda_pas, printed_passive});
}

template <class T>
T pick(const char* option, const std::string& got,
       std::initializer_list<std::pair<const char*, T>> known) {
  std::string allowed;
  for (const auto& [name, value] : known) {
    if (got == name) return value;
    allowed += (allowed.empty() ? "'" : ", '") + std::string(name) + "'";
  }
  throw InputError(std::string(option) + ": got '" + got + "', allowed are " + allowed);
}

std::unique_ptr<Simulator> make_simulator(std::shared_ptr<Device> device, const VoxelModel& model,
                                          const std::string& precision,
                                          const std::string& hourglass, double kappa,
                                          double damping, double mass_scaling,
                                          const std::string& kernels, std::size_t n_bands) {
  SimulatorOptions options;
  options.precision = pick<Precision>(
      "precision", precision, {{"single", Precision::kSingle}, {"double", Precision::kDouble}});
  options.hourglass =
      pick<HourglassForm>("hourglass", hourglass,
                          {{"physical", HourglassForm::kPhysical}, {"joldes", HourglassForm::kKappa}});
  options.kernels = pick<KernelPath>("kernels", kernels,
                                     {{"auto", KernelPath::kAuto},
                                      {"rows", KernelPath::kRows},
                                      {"gather", KernelPath::kGather}});
  options.kappa = kappa;
  options.damping = damping;
  options.mass_scaling = mass_scaling;
  options.n_bands = n_bands;
  py::gil_scoped_release release;
  return std::make_unique<Simulator>(std::move(device), model, options);
}

// (dt, node, element)
py::tuple bound_tuple(const TimeStepBound& bound) {
  return py::make_tuple(bound.dt, bound.node, bound.element);
}

}  // namespace

void define_simulator(py::module_& module) {
  module.def("copy_bandwidth", [] { return copy_bandwidth(); },
             py::call_guard<py::gil_scoped_release>(), "Copy bandwidth of the host, GB/s.");
  py::class_<VoxelModel>(module, "VoxelModel", "Plain arrays of a voxel model; see Model.")
      .def(py::init(&make_model), py::kw_only(), py::arg("voxel"), py::arg("cells"),
           py::arg("node_ijk"), py::arg("mu"), py::arg("bulk_log"), py::arg("bulk_quadratic"),
           py::arg("density"), py::arg("bending_modulus"), py::arg("fixed"), py::arg("gravity"))
      .def("add_muscle", &add_muscle, py::kw_only(), py::arg("name"), py::arg("elements"),
           py::arg("fibre"), py::arg("weight"), py::arg("sigma_act"), py::arg("sigma_pas"),
           py::arg("lambda_opt"), py::arg("lambda_pas"), py::arg("printed_passive") = false);

  py::class_<Simulator>(module, "Simulator", "The step loop on one device; see tledface.Simulator.")
      .def(py::init(&make_simulator), py::arg("device"), py::arg("model"), py::kw_only(),
           py::arg("precision"), py::arg("hourglass"), py::arg("kappa"), py::arg("damping"),
           py::arg("mass_scaling"), py::arg("kernels") = "auto", py::arg("n_bands") = 0)
      .def(
          "step",
          [](Simulator& sim, std::size_t n, const Array<double>& activations) {
            const auto values = to_vector(activations);
            py::gil_scoped_release release;
            sim.step(n, values);
          },
          py::arg("n"), py::arg("activations"))
      .def("finish", &Simulator::finish, py::call_guard<py::gil_scoped_release>())
      .def_property("dt", &Simulator::dt, &Simulator::set_dt)
      .def("bound_at_rest", [](const Simulator& sim) { return bound_tuple(sim.bound_at_rest()); })
      .def("bound_now", [](Simulator& sim) { return bound_tuple(sim.bound_now()); })
      .def_property_readonly("time", &Simulator::time)
      .def_property_readonly("n_steps", &Simulator::n_steps)
      .def_property_readonly("uses_rows", &Simulator::uses_rows)
      .def_property_readonly("fill", [](const Simulator& sim) { return sim.arrays().fill(); })
      .def_property_readonly("device_bytes", &Simulator::device_bytes)
      .def_property_readonly("lanes", [](const Simulator& sim) { return sim.arrays().lanes; })
      .def_property_readonly("n_blocks", [](const Simulator& sim) { return sim.arrays().n_blocks; })
      .def_property_readonly("axis_order", [](const Simulator& sim) { return sim.arrays().order; })
      .def_property_readonly("single",
                             [](const Simulator& sim) {
                               return sim.options().precision == Precision::kSingle;
                             })
      .def("node_slots",
           [](const Simulator& sim) {
             return to_array(std::vector<std::int64_t>(sim.arrays().node_slot));
           })
      .def("node_masses",
           [](const Simulator& sim) {
             return to_array(std::vector<double>(sim.arrays().node_mass));
           })
      .def("displacement", [](Simulator& sim) { return to_array(sim.displacement(), 3); })
      .def("velocity", [](Simulator& sim) { return to_array(sim.velocity(), 3); })
      .def(
          "set_state",
          [](Simulator& sim, const Array<double>& u, const Array<double>& velocity, double time) {
            sim.set_state(to_vector(u), to_vector(velocity), time);
          },
          py::arg("u"), py::arg("velocity"), py::arg("time"))
      .def("internal_force",
           [](Simulator& sim, const Array<double>& activations) {
             return to_array(sim.internal_force(to_vector(activations)), 3);
           })
      .def("element_state",
           [](Simulator& sim, const Array<double>& activations) {
             ElementState state = sim.element_state(to_vector(activations));
             py::dict result;
             result["deformation_gradient"] = to_array(std::move(state.deformation_gradient), 9);
             result["stress"] = to_array(std::move(state.stress), 6);
             result["energy_density"] = to_array(std::move(state.energy_density));
             result["hourglass_density"] = to_array(std::move(state.hourglass_density));
             result["growth"] = to_array(std::move(state.growth));
             return result;
           })
      .def("first_non_finite_node", &Simulator::first_non_finite_node)
      // The displacement buffer: address in this process (native) or cl_mem (OpenCL), else 0.
      .def_property_readonly("buffer_address",
                             [](const Simulator& sim) {
                               return reinterpret_cast<std::uintptr_t>(
                                   sim.displacement_buffer().host_pointer());
                             })
      .def_property_readonly("buffer_handle", [](const Simulator& sim) {
        return reinterpret_cast<std::uintptr_t>(sim.displacement_buffer().opencl_handle());
      });
}
