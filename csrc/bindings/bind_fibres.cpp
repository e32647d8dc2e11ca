// Fibre fields of muscles: samples inside a surface, parameters in a spline volume.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "core/error.hpp"
#include "mesh/surface.hpp"
#include "voxel/fibre_samples.hpp"
#include "voxel/spline_volume.hpp"

namespace py = pybind11;
using namespace tledface;

namespace {

template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;

Vec3 to_vec3(const std::array<double, 3>& a) { return {a[0], a[1], a[2]}; }

std::vector<Vec3> to_points(const Array<double>& array, const char* name) {
  if (array.ndim() != 2 || array.shape(1) != 3)
    throw InputError(std::string(name) + ": an array of shape (n, 3) is needed");
  std::vector<Vec3> points(static_cast<std::size_t>(array.shape(0)));
  const double* data = array.data();
  for (std::size_t i = 0; i < points.size(); ++i)
    points[i] = {data[3 * i], data[3 * i + 1], data[3 * i + 2]};
  return points;
}

template <class T>
py::array_t<T> to_rows(const std::vector<T>& values, std::size_t columns) {
  const std::size_t rows = values.size() / columns;
  py::array_t<T> array({rows, columns});
  std::copy(values.begin(), values.end(), array.mutable_data());
  return array;
}

py::tuple bind_samples_inside(const Surface& surface, std::array<double, 3> origin,
                              std::array<double, 3> voxel, std::array<std::int64_t, 3> count,
                              int samples) {
  CellSamples found;
  {
    py::gil_scoped_release unlocked;
    found = samples_inside(surface.mesh, {to_vec3(origin), to_vec3(voxel), count}, samples);
  }
  const auto size = static_cast<std::size_t>(samples) * samples * samples;
  return py::make_tuple(to_rows(found.cells, 3), to_rows(found.inside, size));
}

py::tuple bind_locate(std::array<int, 3> degree, std::array<std::vector<double>, 3> knots,
                      const Array<double>& control, const Array<double>& points,
                      const Array<double>& guesses) {
  const SplineVolume volume{degree, std::move(knots), to_points(control, "control")};
  check_volume(volume);
  const auto at = to_points(points, "points"), start = to_points(guesses, "guesses");
  if (at.size() != start.size()) throw InputError("guesses: one for each point is needed");
  py::array_t<double> parameters({at.size(), std::size_t{3}}), along({at.size(), std::size_t{3}});
  py::array_t<double> distance2(static_cast<py::ssize_t>(at.size()));
  double *p = parameters.mutable_data(), *t = along.mutable_data(), *d = distance2.mutable_data();
  {
    py::gil_scoped_release unlocked;
    for (const VolumeHit& hit : locate_in_volume(volume, at, start)) {
      for (int axis = 0; axis < 3; ++axis) {
        *p++ = hit.parameters[axis];
        *t++ = hit.along[axis];
      }
      *d++ = hit.distance2;
    }
  }
  return py::make_tuple(parameters, along, distance2);
}

}  // namespace

void define_fibres(py::module_& module) {
  module.def("samples_inside", &bind_samples_inside, py::arg("surface"), py::arg("origin"),
             py::arg("voxel"), py::arg("count"), py::arg("samples"),
             "Cells (m, 3) with samples inside a surface, and which (m, samples^3) those are.");
  module.def("locate_in_volume", &bind_locate, py::kw_only(), py::arg("degree"), py::arg("knots"),
             py::arg("control"), py::arg("points"), py::arg("guesses"),
             "Parameters of points in a B-spline volume, its derivative along u there (m), and the "
             "squared distance left (m^2).");
}
