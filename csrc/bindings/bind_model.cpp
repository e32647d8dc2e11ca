// Searches that make a model from voxels and surfaces: arrays in, arrays out.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.hpp"
#include "model/nearest_cells.hpp"
#include "model/nearest_surface.hpp"

namespace py = pybind11;
using namespace tledface;

namespace {

py::tuple bind_nearest_cells(const Array<std::int32_t>& cells_in, std::array<double, 3> voxel,
                             const Array<double>& points_in) {
  check_columns(cells_in, "cells", 3);
  if (cells_in.shape(0) == 0) throw InputError("cells: at least one element is needed");
  const std::vector<std::int32_t> cells(cells_in.data(), cells_in.data() + cells_in.size());
  const std::vector<Vec3> points = to_points(points_in, "points");
  NearestCells found;
  {
    py::gil_scoped_release unlocked;
    found = nearest_cells(cells, {voxel[0], voxel[1], voxel[2]}, points);
  }
  return py::make_tuple(to_array(std::move(found.element)), to_array(std::move(found.distance)));
}

void check_faces(const TriangleMesh& mesh) {
  for (const Face& face : mesh.faces)
    for (const auto v : face)
      if (v < 0 || static_cast<std::size_t>(v) >= mesh.vertices.size())
        throw InputError("faces: one names vertex " + std::to_string(v) + " of " +
                         std::to_string(mesh.vertices.size()));
}

py::tuple bind_weld(const Array<double>& vertices, const Array<std::int32_t>& faces) {
  const TriangleMesh mesh = to_mesh(vertices, faces);
  check_faces(mesh);
  TriangleMesh welded;
  {
    py::gil_scoped_release unlocked;
    welded = weld(mesh, 0);
  }
  return py::make_tuple(points_array(welded.vertices), faces_array(welded.faces));
}

using Meshes = std::vector<std::pair<Array<double>, Array<std::int32_t>>>;

std::vector<TriangleMesh> to_surfaces(const Meshes& meshes) {
  std::vector<TriangleMesh> surfaces;
  for (const auto& [vertices, faces] : meshes) {
    surfaces.push_back(to_mesh(vertices, faces));
    check_faces(surfaces.back());
    if (surfaces.back().faces.empty()) throw InputError("faces: a surface has none");
  }
  if (surfaces.empty()) throw InputError("surfaces: at least one is needed");
  return surfaces;
}

py::dict bind_nearest_surfaces(const Meshes& meshes, const Array<double>& points_in,
                               double tolerance) {
  const std::vector<TriangleMesh> surfaces = to_surfaces(meshes);
  const std::vector<Vec3> points = to_points(points_in, "points");
  const std::size_t n = points.size();
  std::vector<std::int32_t> surface(n), face(n);
  std::vector<double> distance(n);
  std::vector<Vec3> closest(n), normal(n);
  py::array_t<bool> tied(static_cast<py::ssize_t>(n));
  bool* const tied_data = tied.mutable_data();
  {
    py::gil_scoped_release unlocked;
    const auto found = nearest_surfaces(surfaces, points, tolerance);
    for (std::size_t i = 0; i < n; ++i) {
      surface[i] = found[i].surface;
      face[i] = found[i].face;
      distance[i] = found[i].distance;
      closest[i] = found[i].point;
      normal[i] = found[i].normal;
      tied_data[i] = found[i].tied;
    }
  }
  py::dict d;
  d["surface"] = to_array(std::move(surface));
  d["face"] = to_array(std::move(face));
  d["distance"] = to_array(std::move(distance));
  d["point"] = points_array(closest);
  d["normal"] = points_array(normal);
  d["tied"] = tied;
  return d;
}

py::array_t<bool> bind_segments_meet(const Meshes& meshes, const Array<double>& starts_in,
                                     const Array<double>& ends_in) {
  const std::vector<TriangleMesh> surfaces = to_surfaces(meshes);
  const std::vector<Vec3> starts = to_points(starts_in, "starts");
  const std::vector<Vec3> ends = to_points(ends_in, "ends");
  if (starts.size() != ends.size()) throw InputError("ends: as many as starts are needed");
  std::vector<char> meets;
  {
    py::gil_scoped_release unlocked;
    meets = segments_meet(surfaces, starts, ends);
  }
  py::array_t<bool> result(static_cast<py::ssize_t>(meets.size()));
  std::copy(meets.begin(), meets.end(), result.mutable_data());
  return result;
}

}  // namespace

void define_model(py::module_& module) {
  module.def("nearest_cells", &bind_nearest_cells, py::arg("cells"), py::arg("voxel"),
             py::arg("points"),
             "Element nearest to each point (in voxels from the grid's corner) and the distance, "
             "m.");
  module.def("weld", &bind_weld, py::arg("vertices"), py::arg("faces"),
             "Vertices and faces with equal vertices merged, in an order of their own.");
  module.def("nearest_surfaces", &bind_nearest_surfaces, py::arg("surfaces"), py::arg("points"),
             py::arg("tolerance"),
             "The nearest of several (vertices, faces) to each point: surface, face, signed "
             "distance (m), point, unit normal, tied.");
  module.def("segments_meet", &bind_segments_meet, py::arg("surfaces"), py::arg("starts"),
             py::arg("ends"), "Which segments meet any of several (vertices, faces).");
}
