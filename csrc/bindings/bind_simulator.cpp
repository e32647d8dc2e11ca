// Simulator: arrays in and out in the model's node and element order, float64.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <optional>

#include "bindings/options.hpp"
#include "broad_phase/near_points.hpp"
#include "broad_phase/zones.hpp"
#include "core/bandwidth.hpp"
#include "core/error.hpp"
#include "precompute/law_table.hpp"
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
                      const Array<double>& density, const Array<double>& shear_modulus,
                      const Array<double>& bulk_modulus, const Array<double>& bending_modulus,
                      const Array<std::uint8_t>& fixed, std::array<double, 3> gravity) {
  VoxelModel model;
  model.voxel = voxel;
  model.cells = to_vector(cells);
  model.node_ijk = to_vector(node_ijk);
  model.mu = to_vector(mu);
  model.bulk_log = to_vector(bulk_log);
  model.bulk_quadratic = to_vector(bulk_quadratic);
  model.density = to_vector(density);
  model.shear_modulus = to_vector(shear_modulus);
  model.bulk_modulus = to_vector(bulk_modulus);
  model.bending_modulus = to_vector(bending_modulus);
  model.fixed = to_vector(fixed);
  model.gravity = gravity;
  return model;
}

void add_muscle(VoxelModel& model, const std::string& name, const Array<std::int64_t>& elements,
                const Array<double>& fibre, const Array<double>& weight, double sigma_act,
                double sigma_pas, double lambda_opt, double lambda_pas, bool calcium, double beta,
                bool printed_passive) {
  if (fibre.size() != 3 * elements.size() || weight.size() != elements.size())
    throw InputError("muscle '" + name + "': elements, fibre and weight differ in length");
  model.muscles.push_back({name, to_vector(elements), to_vector(fibre), to_vector(weight),
                           sigma_act, sigma_pas, lambda_opt, lambda_pas, calcium, beta,
                           printed_passive});
}

std::unique_ptr<Simulator> make_simulator(
    std::shared_ptr<Device> device, const VoxelModel& model, const std::string& precision,
    const std::string& hourglass, double kappa, double damping, const std::string& kernels,
    std::size_t n_bands, std::array<int, 3> tile, int registers, std::optional<bool> recorded,
    const Conditions* conditions, const SlidingNodes* sliding) {
  SimulatorOptions options;
  options.precision = pick_precision(precision);
  options.hourglass = pick_hourglass(hourglass);
  options.kernels = pick_kernels(kernels);
  options.tile = make_tile(tile);
  options.registers = registers;
  options.recorded = recorded;
  options.kappa = kappa;
  options.damping = damping;
  options.n_bands = n_bands;
  py::gil_scoped_release release;
  return std::make_unique<Simulator>(std::move(device), model, options,
                                     conditions ? *conditions : Conditions(),
                                     sliding ? *sliding : SlidingNodes());
}

void add_prescribed(Conditions& conditions, const Array<std::int64_t>& dofs) {
  const auto given = to_vector(dofs);
  conditions.prescribed_dofs.insert(conditions.prescribed_dofs.end(), given.begin(), given.end());
  conditions.prescribed_channels.insert(conditions.prescribed_channels.end(), given.size(),
                                        conditions.n_prescribed++);
}

void add_fields(Conditions& conditions, const Array<std::int64_t>& dofs) {
  const auto given = to_vector(dofs);
  conditions.field_dofs.insert(conditions.field_dofs.end(), given.begin(), given.end());
}

void add_load(Conditions& conditions, const Array<std::int64_t>& dofs,
              const Array<double>& forces) {
  if (dofs.size() != forces.size())
    throw InputError("load: degrees of freedom and forces differ in length");
  const auto given = to_vector(dofs);
  const auto values = to_vector(forces);
  conditions.load_dofs.insert(conditions.load_dofs.end(), given.begin(), given.end());
  conditions.load_forces.insert(conditions.load_forces.end(), values.begin(), values.end());
  conditions.load_channels.insert(conditions.load_channels.end(), given.size(),
                                  conditions.n_loads++);
}

void add_pressure(Conditions& conditions, const Array<std::int32_t>& faces) {
  const auto given = to_vector(faces);
  if (given.size() % 4 != 0) throw InputError("pressure: a face has four nodes");
  conditions.pressure_faces.insert(conditions.pressure_faces.end(), given.begin(), given.end());
  conditions.pressure_channels.insert(conditions.pressure_channels.end(), given.size() / 4,
                                      conditions.n_pressures++);
}

TriangleMesh make_mesh(const Array<double>& vertices, const Array<std::int32_t>& faces) {
  if (vertices.size() % 3 || faces.size() % 3)
    throw InputError("sliding: a vertex has three coordinates, a face three corners");
  TriangleMesh mesh;
  for (py::ssize_t i = 0; i < vertices.size(); i += 3)
    mesh.vertices.push_back({vertices.data()[i], vertices.data()[i + 1], vertices.data()[i + 2]});
  const auto n = static_cast<std::int32_t>(mesh.vertices.size());
  for (py::ssize_t i = 0; i < faces.size(); i += 3) {
    mesh.faces.push_back({faces.data()[i], faces.data()[i + 1], faces.data()[i + 2]});
    for (const std::int32_t corner : mesh.faces.back())
      if (corner < 0 || corner >= n)
        throw InputError("sliding: a face names vertex " + std::to_string(corner) +
                         ", which does not exist");
  }
  return mesh;
}

// Squared distances and faces.
py::tuple nearest_tuple(const std::vector<NearestTriangle>& found) {
  std::vector<double> squares;
  std::vector<std::int32_t> faces;
  for (const NearestTriangle& nearest : found) {
    squares.push_back(nearest.square);
    faces.push_back(nearest.face);
  }
  return py::make_tuple(to_array(std::move(squares)), to_array(std::move(faces)));
}

std::vector<Vec3> make_points(const Array<double>& points) {
  std::vector<Vec3> result;
  for (py::ssize_t i = 0; i + 2 < points.size(); i += 3)
    result.push_back({points.data()[i], points.data()[i + 1], points.data()[i + 2]});
  return result;
}

StepInput make_input(const Array<double>& activations, const Array<double>& values,
                     const Array<double>& keys) {
  return {to_vector(activations), to_vector(values), to_vector(keys)};
}

// What a function that may wait for the device gives, while Python's lock is free.
template <class Function>
auto without_lock(Function function) {
  py::gil_scoped_release release;
  return function();
}

py::dict state_dict(ElementState&& state) {
  py::dict result;
  result["deformation_gradient"] = to_array(std::move(state.deformation_gradient), 9);
  result["stress"] = to_array(std::move(state.stress), 6);
  result["energy_density"] = to_array(std::move(state.energy_density));
  result["hourglass_density"] = to_array(std::move(state.hourglass_density));
  return result;
}

// (dt, node, element)
py::tuple bound_tuple(const TimeStepBound& bound) {
  return py::make_tuple(bound.dt, bound.node, bound.element);
}

}  // namespace

void define_simulator(py::module_& module) {
  module.def(
      "copy_bandwidth", [] { return copy_bandwidth(); }, py::call_guard<py::gil_scoped_release>(),
      "Copy bandwidth of the host, GB/s.");
  py::class_<VoxelModel>(module, "VoxelModel", "Plain arrays of a voxel model; see Model.")
      .def(py::init(&make_model), py::kw_only(), py::arg("voxel"), py::arg("cells"),
           py::arg("node_ijk"), py::arg("mu"), py::arg("bulk_log"), py::arg("bulk_quadratic"),
           py::arg("density"), py::arg("shear_modulus"), py::arg("bulk_modulus"),
           py::arg("bending_modulus"), py::arg("fixed"), py::arg("gravity"))
      .def(
          "add_law",
          [](VoxelModel& model, const std::string& name, const Array<std::int64_t>& elements,
             const Array<double>& rows) {
            law_number(name);
            model.laws.push_back({name, to_vector(elements), to_vector(rows)});
          },
          py::kw_only(), py::arg("name"), py::arg("elements"), py::arg("rows"))
      .def(
          "set_hexahedra",
          [](VoxelModel& model, const Array<double>& positions,
             const Array<std::int32_t>& corners) {
            set_hexahedra(model, to_vector(positions), to_vector(corners));
          },
          py::kw_only(), py::arg("positions"), py::arg("corners"))
      .def_property_readonly("element_volumes",
                             [](const VoxelModel& model) {
                               std::vector<double> volumes(model.n_elements());
                               for (std::size_t e = 0; e < volumes.size(); ++e)
                                 volumes[e] = model.element_volume(e);
                               return to_array(std::move(volumes));
                             })
      .def_property_readonly("shortest_edge", &VoxelModel::shortest_edge)
      .def("add_muscle", &add_muscle, py::kw_only(), py::arg("name"), py::arg("elements"),
           py::arg("fibre"), py::arg("weight"), py::arg("sigma_act"), py::arg("sigma_pas"),
           py::arg("lambda_opt"), py::arg("lambda_pas"), py::arg("calcium") = false,
           py::arg("beta") = 0.0, py::arg("printed_passive") = false);

  module.def(
      "element_stiffness",
      [](const VoxelModel& model) { return to_array(element_stiffness(model)); }, py::arg("model"),
      "Stiffness of each element at rest, fibres at their steepest, Pa/m2: density omega^2 / 4.");

  py::class_<Conditions>(module, "Conditions", "What acts on single nodes; see Model.")
      .def(py::init<>())
      .def("add_prescribed", &add_prescribed, py::arg("dofs"))
      .def("add_fields", &add_fields, py::arg("dofs"))
      .def("add_load", &add_load, py::arg("dofs"), py::arg("forces"))
      .def("add_pressure", &add_pressure, py::arg("faces"));

  py::class_<SlidingNodes>(module, "SlidingNodes", "Nodes that slide on surfaces; see Model.slide.")
      .def(py::init<>())
      .def(
          "add_surface",
          [](SlidingNodes& sliding, const Array<double>& vertices,
             const Array<std::int32_t>& faces) {
            sliding.surfaces.push_back(make_mesh(vertices, faces));
          },
          py::arg("vertices"), py::arg("faces"))
      .def(
          "set_nodes",
          [](SlidingNodes& sliding, const Array<std::int64_t>& nodes,
             const Array<std::int32_t>& surface, const Array<double>& distance) {
            sliding.nodes = to_vector(nodes);
            sliding.surface = to_vector(surface);
            sliding.distance = to_vector(distance);
          },
          py::arg("nodes"), py::arg("surface"), py::arg("distance"))
      .def(
          "set_laws",
          [](SlidingNodes& sliding, const Array<double>& friction,
             const Array<std::uint8_t>& release) {
            sliding.friction = to_vector(friction);
            sliding.release = to_vector(release);
          },
          py::arg("friction"), py::arg("release"))
      .def(
          "set_moving",
          [](SlidingNodes& sliding, const Array<std::int32_t>& surfaces) {
            sliding.moving = to_vector(surfaces);
          },
          py::arg("surfaces"));

  module.def(
      "grid_nearest",
      [](std::shared_ptr<Device> device, const std::string& precision,
         const Array<double>& vertices, const Array<std::int32_t>& faces,
         const Array<double>& points) {
        return nearest_tuple(nearest_in_grid(
            *device, precision == "double" ? Precision::kDouble : Precision::kSingle,
            make_mesh(vertices, faces), make_points(points)));
      },
      py::arg("device"), py::arg("precision"), py::arg("vertices"), py::arg("faces"),
      py::arg("points"), "Squared distances (m^2) and faces that a device's grid search finds.");
  module.def(
      "brute_force_nearest",
      [](const Array<double>& vertices, const Array<std::int32_t>& faces,
         const Array<double>& points) {
        return nearest_tuple(
            nearest_by_brute_force(make_mesh(vertices, faces), make_points(points)));
      },
      py::arg("vertices"), py::arg("faces"), py::arg("points"),
      "The same by trying every triangle, in float64.");
  module.def(
      "surface_zones",
      [](const Array<double>& vertices, const Array<std::int32_t>& faces, double reach,
         const std::optional<Array<double>>& near, double margin) {
        if (near && !(margin > 0)) throw InputError("surface_zones: near needs a margin above 0 m");
        const auto grids =
            make_surface_grids({make_mesh(vertices, faces)}, Vec3{0, 0, 0}, {0, 1, 2});
        std::vector<std::vector<std::uint8_t>> wanted;
        if (near) wanted.push_back(triangles_near(grids, 0, make_points(*near), margin));
        Zones zones = make_zones(grids, {{reach, 0.0}}, wanted, 1e-15);
        return py::make_tuple(to_array(std::move(zones.reals)),
                              to_array(std::move(zones.of_triangle)));
      },
      py::arg("vertices"), py::arg("faces"), py::arg("reach"), py::arg("near") = py::none(),
      py::arg("margin") = 0.0,
      "Zones of a surface's faces and edges within reach (m) before it, and those of each "
      "triangle, as kernels_cl/sliding_layout.cl lays them out. near: (n, 3) m, zones are only of "
      "triangles within `margin` (m) of these points and some farther; None: of all.");

  // Its functions wait without Python's lock, so that the thread of the simulator goes on.
  py::class_<Snapshot>(module, "Snapshot", "A moment of a simulation; see snapshot.hpp.")
      .def_property_readonly("time", &Snapshot::time)
      .def_property_readonly("n_steps", &Snapshot::n_steps)
      .def("displacement",
           [](Snapshot& snapshot) {
             return to_array(without_lock([&] { return snapshot.displacement(); }), 3);
           })
      .def("element_state", [](Snapshot& snapshot) {
        return state_dict(without_lock([&] { return snapshot.element_state(); }));
      });
  py::class_<Simulator>(module, "Simulator", "The step loop on one device; see tledface.Simulator.")
      .def(py::init(&make_simulator), py::arg("device"), py::arg("model"), py::kw_only(),
           py::arg("precision"), py::arg("hourglass"), py::arg("kappa"), py::arg("damping"),
           py::arg("kernels") = "auto", py::arg("n_bands") = 0,
           py::arg("tile") = py::make_tuple(16, 8, 0), py::arg("registers") = 0,
           py::arg("recorded") = py::none(), py::arg("conditions") = py::none(),
           py::arg("sliding") = py::none())
      .def(
          "step",
          [](Simulator& sim, std::size_t n, const Array<double>& activations,
             const std::optional<Array<double>>& values, const std::optional<Array<double>>& keys) {
            const Array<double> none(0);
            const StepInput input =
                make_input(activations, values.value_or(none), keys.value_or(none));
            py::gil_scoped_release release;
            sim.step(n, input);
          },
          py::arg("n"), py::arg("activations"), py::arg("values") = py::none(),
          py::arg("keys") = py::none())
      .def_property_readonly("can_subcycle", &Simulator::can_subcycle)
      .def_property("substeps", &Simulator::substeps, &Simulator::set_substeps)
      .def("choose_levels", &Simulator::choose_levels)
      .def("relative_cost",
           [](const Simulator& sim) { return relative_cost(sim.arrays(), sim.levels()); })
      .def("node_squares", [](Simulator& sim) { return to_array(sim.node_squares()); })
      .def("node_steps", [](const Simulator& sim) { return to_array(sim.node_steps()); })
      .def_property_readonly("n_prescribed",
                             [](const Simulator& sim) { return sim.conditions().n_prescribed; })
      .def_property_readonly("n_pose_values",
                             [](const Simulator& sim) { return sim.n_pose_values(); })
      .def("first_key", &Simulator::first_key)
      .def("last_key", &Simulator::last_key, py::arg("steps"))
      .def("key_time", &Simulator::key_time, py::arg("key"))
      .def(
          "set_prescribed",
          [](Simulator& sim, const Array<double>& values, const Array<double>& fields) {
            sim.set_prescribed(to_vector(values), to_vector(fields));
          },
          py::arg("values"), py::arg("fields"))
      .def(
          "external_force",
          [](Simulator& sim, const Array<double>& values) {
            return to_array(sim.external_force(to_vector(values)), 3);
          },
          py::arg("values"))
      .def(
          "begin_relaxation",
          [](Simulator& sim, const Array<double>& node_mass) {
            sim.begin_relaxation(to_vector(node_mass));
          },
          py::arg("node_mass"))
      .def(
          "relax",
          // steps: (n, 3) of RelaxationStep.
          [](Simulator& sim, const Array<double>& steps, const Array<double>& activations,
             const Array<double>& values, const Array<double>& keys) {
            std::vector<RelaxationStep> rows(static_cast<std::size_t>(steps.size() / 3));
            for (std::size_t i = 0; i < rows.size(); ++i)
              rows[i] = {steps.data()[3 * i], steps.data()[3 * i + 1], steps.data()[3 * i + 2]};
            const StepInput input = make_input(activations, values, keys);
            py::gil_scoped_release release;
            sim.relax(rows, input);
          },
          py::arg("steps"), py::arg("activations"), py::arg("values"), py::arg("keys"))
      .def("end_relaxation", &Simulator::end_relaxation)
      .def("in_double", &Simulator::in_double)
      .def("take_state", &Simulator::take_state, py::arg("other"))
      .def("relaxation_masses", [](Simulator& sim) { return to_array(sim.relaxation_masses()); })
      .def("sliding_normals",
           [](const Simulator& sim) { return to_array(sim.sliding_normals(), 3); })
      .def("friction_losses", [](const Simulator& sim) { return to_array(sim.friction_losses()); })
      .def("finish", &Simulator::finish, py::call_guard<py::gil_scoped_release>())
      .def_property("dt", &Simulator::dt, &Simulator::set_dt)
      .def("bound_at_rest", [](const Simulator& sim) { return bound_tuple(sim.bound_at_rest()); })
      .def(
          "limit_now",
          // (limit, node, element, bound)
          [](Simulator& sim, const Array<double>& activations, double enough, double reach_low,
             double reach_high) {
            const auto values = to_vector(activations);
            py::gil_scoped_release release;
            const StepLimit limit = sim.limit_now({values, reach_low, reach_high}, enough);
            py::gil_scoped_acquire acquire;
            return py::make_tuple(limit.dt, limit.bound.node, limit.bound.element, limit.bound.dt);
          },
          py::arg("activations"), py::arg("enough"), py::arg("reach_low") = 1.0,
          py::arg("reach_high") = 1.0)
      .def(
          "measured_limit",
          [](Simulator& sim, const Array<double>& activations) {
            const StepLimit limit = sim.measured_limit(to_vector(activations));
            return py::make_tuple(limit.dt, limit.bound.node, limit.bound.element);
          },
          py::arg("activations"))
      .def_property_readonly("time", &Simulator::time)
      // Whether the next step is the first from a given state.
      .def_property_readonly("starts", &Simulator::starts)
      .def("time_after", &Simulator::time_after, py::arg("steps"))
      .def(
          "times_after",
          [](const Simulator& sim, const Array<std::int64_t>& steps) {
            std::vector<double> times(static_cast<std::size_t>(steps.size()));
            for (std::size_t i = 0; i < times.size(); ++i)
              times[i] = sim.time_after(steps.data()[i]);
            return to_array(std::move(times));
          },
          py::arg("steps"))
      .def_property_readonly("n_steps", &Simulator::n_steps)
      .def_property_readonly("uses_rows", &Simulator::uses_rows)
      .def_property_readonly("kernels", &Simulator::kernels)
      .def_property_readonly("limit_iterations", &Simulator::limit_iterations,
                             "How often the limit of the step was iterated for.")
      .def_property_readonly(
          "has_laws", [](const Simulator& sim) { return !sim.model().laws.empty(); },
          "Whether there are constitutive laws beyond the base ones.")
      .def_property_readonly("fuses_sliding", &Simulator::fuses_sliding,
                             "Whether the kernels of a step put sliding nodes back themselves.")
      .def_property_readonly("fill", [](const Simulator& sim) { return sim.arrays().fill(); })
      .def_property_readonly("device_bytes", &Simulator::device_bytes)
      .def_property_readonly("lanes", [](const Simulator& sim) { return sim.arrays().lanes; })
      .def_property_readonly("n_blocks", [](const Simulator& sim) { return sim.arrays().n_blocks; })
      .def_property_readonly("axis_order", [](const Simulator& sim) { return sim.arrays().order; })
      .def_property_readonly(
          "single",
          [](const Simulator& sim) { return sim.options().precision == Precision::kSingle; })
      .def("node_slots",
           [](const Simulator& sim) {
             return to_array(std::vector<std::int64_t>(sim.arrays().node_slot));
           })
      .def("node_masses",
           [](const Simulator& sim) {
             return to_array(std::vector<double>(sim.arrays().node_mass));
           })
      .def("displacement",
           [](Simulator& sim) {
             return to_array(without_lock([&] { return sim.displacement(); }), 3);
           })
      .def("velocity", [](Simulator& sim) { return to_array(sim.velocity(), 3); })
      .def(
          "set_state",
          [](Simulator& sim, const Array<double>& u, const Array<double>& velocity, double time) {
            sim.set_state(to_vector(u), to_vector(velocity), time);
          },
          py::arg("u"), py::arg("velocity"), py::arg("time"))
      .def("raw_state",
           [](Simulator& sim) {
             RawState state = without_lock([&] { return sim.raw_state(); });
             py::dict result;
             result["u"] = to_array(std::move(state.u));
             result["u_prev"] = to_array(std::move(state.u_prev));
             result["history"] = to_array(std::move(state.history));
             result["clock_start"] = state.clock_start;
             result["clock_steps"] = state.clock_steps;
             result["dt"] = state.dt;
             result["n_steps"] = state.n_steps;
             result["starts"] = state.starts;
             result["limit_squares"] = to_array(std::move(state.limit_squares));
             result["limit_square"] = state.limit_square;
             result["sliding"] = to_array(std::move(state.sliding));
             result["levels"] = to_array(std::move(state.levels));
             return result;
           })
      .def(
          "set_raw_state",
          [](Simulator& sim, const Array<std::uint8_t>& u, const Array<std::uint8_t>& u_prev,
             const Array<std::uint8_t>& history, double clock_start, std::int64_t clock_steps,
             double dt, std::int64_t n_steps, bool starts, const Array<double>& limit_squares,
             double limit_square, const std::optional<Array<std::uint8_t>>& sliding,
             const std::optional<Array<std::uint8_t>>& levels) {
            const auto bytes = [](const std::optional<Array<std::uint8_t>>& array) {
              return array ? to_vector(*array) : std::vector<std::uint8_t>();
            };
            sim.set_raw_state({to_vector(u), to_vector(u_prev), to_vector(history), clock_start, dt,
                               clock_steps, n_steps, starts, to_vector(limit_squares), limit_square,
                               bytes(sliding), bytes(levels)});
          },
          py::kw_only(), py::arg("u"), py::arg("u_prev"), py::arg("history"),
          py::arg("clock_start"), py::arg("clock_steps"), py::arg("dt"), py::arg("n_steps"),
          py::arg("starts"), py::arg("limit_squares"), py::arg("limit_square"),
          py::arg("sliding") = py::none(), py::arg("levels") = py::none())
      .def("weighted_force",
           [](Simulator& sim, const Array<double>& activations) {
             return to_array(sim.weighted_force(to_vector(activations)), 3);
           })
      .def("internal_force",
           [](Simulator& sim, const Array<double>& activations) {
             return to_array(sim.internal_force(to_vector(activations)), 3);
           })
      .def("element_state",
           [](Simulator& sim, const Array<double>& activations) {
             const auto values = to_vector(activations);
             return state_dict(without_lock([&] { return sim.element_state(values); }));
           })
      .def("first_non_finite_node", &Simulator::first_non_finite_node,
           py::call_guard<py::gil_scoped_release>())
      .def(
          "snapshot",
          [](Simulator& sim, const Array<double>& activations) {
            const auto values = to_vector(activations);
            py::gil_scoped_release release;
            return sim.snapshot(values);
          },
          py::arg("activations"), py::keep_alive<0, 1>())
      .def_property_readonly("records", &Simulator::records)
      // The displacement buffer: address in this process (native) or cl_mem (OpenCL), else 0.
      .def_property_readonly(
          "buffer_address",
          [](const Simulator& sim) {
            return reinterpret_cast<std::uintptr_t>(sim.displacement_buffer().host_pointer());
          })
      .def_property_readonly("buffer_handle", [](const Simulator& sim) {
        return reinterpret_cast<std::uintptr_t>(sim.displacement_buffer().opencl_handle());
      });
}
