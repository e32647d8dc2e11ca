// Surfaces and voxels: arrays in, arrays out.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>

#include "bindings/arrays.hpp"
#include "core/error.hpp"
#include "mesh/bvh.hpp"
#include "mesh/surface.hpp"
#include "voxel/cells.hpp"
#include "voxel/voxelise.hpp"

namespace py = pybind11;
using namespace tledface;

namespace {

Vec3 to_vec3(const std::array<double, 3>& a) { return {a[0], a[1], a[2]}; }
py::tuple from_vec3(const Vec3& a) { return py::make_tuple(a.x, a.y, a.z); }

py::dict report_dict(const SurfaceReport& report) {
  py::dict d;
  d["vertices_read"] = report.vertices_read;
  d["faces_read"] = report.faces_read;
  d["vertices_welded"] = report.vertices_welded;
  d["degenerate_faces"] = report.degenerate_faces;
  d["duplicate_faces"] = report.duplicate_faces;
  d["flipped_faces"] = report.flipped_faces;
  d["inverted_components"] = report.inverted_components;
  d["cavities"] = report.cavities;
  d["components"] = report.components;
  d["holes_filled"] = report.holes_filled;
  d["largest_hole"] = report.largest_hole;
  d["seams_joined"] = report.seams_joined;
  return d;
}

Surface bind_prepare(const Array<double>& vertices, const Array<std::int32_t>& faces,
                     const std::string& name, double hole_limit) {
  const TriangleMesh mesh = to_mesh(vertices, faces);
  SurfaceOptions options;
  options.hole_limit = hole_limit;
  py::gil_scoped_release unlocked;
  return prepare_surface(mesh, name, options);
}

py::tuple bind_closest(const Surface& surface, const Array<double>& points_in) {
  const std::vector<Vec3> points = to_points(points_in, "points");
  std::vector<double> distance2(points.size());
  std::vector<std::int32_t> face(points.size()), side(points.size());
  std::vector<Vec3> closest(points.size());
  {
    py::gil_scoped_release unlocked;
    const Bvh bvh(surface.mesh);
    const auto hits = closest_points(bvh, points);
    for (std::size_t i = 0; i < hits.size(); ++i) {
      distance2[i] = hits[i].distance2;
      face[i] = hits[i].face;
      closest[i] = hits[i].point;
      side[i] = bvh.side(points[i], hits[i]);
    }
  }
  return py::make_tuple(to_array(std::move(distance2)), to_array(std::move(face)),
                        points_array(closest), to_array(std::move(side)));
}

py::dict bind_voxelise(const Surface& skin, const Array<bool>& outer,
                       const std::vector<const Surface*>& bones,
                       const std::vector<const Surface*>& parts, std::array<double, 3> origin,
                       std::array<double, 3> voxel, std::array<std::int64_t, 3> count, int samples,
                       const std::vector<double>& boundaries, double cap,
                       std::array<double, 3> region_low, std::array<double, 3> region_high) {
  if (outer.ndim() != 1 || static_cast<std::size_t>(outer.shape(0)) != skin.mesh.faces.size())
    throw InputError("outer: one value per skin face is needed");
  VoxeliseInput input;
  input.grid = {to_vec3(origin), to_vec3(voxel), count};
  input.samples = samples;
  input.skin = &skin.mesh;
  input.outer.vertices = skin.mesh.vertices;
  for (std::size_t f = 0; f < skin.mesh.faces.size(); ++f)
    if (outer.data()[f]) input.outer.faces.push_back(skin.mesh.faces[f]);
  for (const Surface* surface : bones) input.bones.push_back(&surface->mesh);
  for (const Surface* surface : parts) input.parts.push_back(&surface->mesh);
  input.boundaries = boundaries;
  input.cap = cap;
  input.region = {to_vec3(region_low), to_vec3(region_high)};
  Voxels voxels;
  {
    py::gil_scoped_release unlocked;
    voxels = voxelise(input);
  }
  py::dict d;
  d["cells"] = to_array(std::move(voxels.cells), 3);
  d["shares"] = to_array(std::move(voxels.shares), voxels.n_tissues);
  d["first"] = to_array(std::move(voxels.first), voxels.n_tissues);
  d["second"] = to_array(std::move(voxels.second), voxels.n_tissues);
  d["normal"] = to_array(std::move(voxels.normal), 3);
  return d;
}

std::vector<std::int32_t> to_cells(const Array<std::int32_t>& cells) {
  check_columns(cells, "cells", 3);
  return {cells.data(), cells.data() + cells.size()};
}

py::tuple bind_clean(const Array<std::int32_t>& cells_in, int min_neighbours) {
  const auto cells = to_cells(cells_in);
  CleanedCells cleaned;
  {
    py::gil_scoped_release unlocked;
    cleaned = clean_cells(cells, min_neighbours);
  }
  py::array_t<bool> keep(static_cast<py::ssize_t>(cleaned.keep.size()));
  std::copy(cleaned.keep.begin(), cleaned.keep.end(), keep.mutable_data());
  return py::make_tuple(keep, cleaned.loose, cleaned.dropped);
}

}  // namespace

void define_geometry(py::module_& module) {
  py::class_<Surface>(module, "Surface", "A closed, oriented triangle surface in metres.")
      .def_readonly("name", &Surface::name)
      .def_readonly("area", &Surface::area, "m^2")
      .def_property_readonly(
          "volume", [](const Surface& s) { return s.moments.volume; }, "m^3")
      .def_property_readonly("centroid",
                             [](const Surface& s) { return from_vec3(s.moments.centroid); })
      .def_property_readonly(
          "covariance", [](const Surface& s) { return s.moments.covariance; },
          "xx yy zz xy yz xz about the centroid, integrated over the volume, m^5")
      .def_property_readonly("vertices",
                             [](const Surface& s) { return points_array(s.mesh.vertices); })
      .def_property_readonly("faces", [](const Surface& s) { return faces_array(s.mesh.faces); })
      .def_property_readonly("report", [](const Surface& s) { return report_dict(s.report); })
      .def("closest_points", &bind_closest, py::arg("points"),
           "Squared distance (m^2), face, closest point and side (+1 outside) of (n, 3) points.");
  module.def("prepare_surface", &bind_prepare, py::arg("vertices"), py::arg("faces"),
             py::arg("name"), py::arg("hole_limit") = SurfaceOptions{}.hole_limit,
             "Checks, welds, orients and closes a triangle surface; raises InputError.");
  module.def("voxelise", &bind_voxelise, py::kw_only(), py::arg("skin"), py::arg("outer"),
             py::arg("bones"), py::arg("parts"), py::arg("origin"), py::arg("voxel"),
             py::arg("count"), py::arg("samples"), py::arg("boundaries"), py::arg("cap"),
             py::arg("region_low"), py::arg("region_high"),
             "Samples surfaces into voxels: cells, shares, first, second, normal.");
  module.def("clean_cells", &bind_clean, py::arg("cells"), py::arg("min_neighbours"),
             "Keep mask, number of loose cells removed, sizes of the smaller parts removed.");
}
