// Surfaces and voxels: arrays in, arrays out.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>

#include "bindings/arrays.hpp"
#include "core/error.hpp"
#include "mesh/bvh.hpp"
#include "mesh/surface.hpp"
#include "voxel/cells.hpp"
#include "voxel/gaps.hpp"
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
  d["open_edges"] = report.open_edges;
  d["holes_filled"] = report.holes_filled;
  d["holes_closed"] = report.holes_closed;
  d["hole_volume"] = report.hole_volume;
  d["largest_hole"] = report.largest_hole;
  d["seams_joined"] = report.seams_joined;
  return d;
}

Surface bind_prepare(const Array<double>& vertices, const Array<std::int32_t>& faces,
                     const std::string& name, double hole_limit, bool close_holes) {
  const TriangleMesh mesh = to_mesh(vertices, faces);
  SurfaceOptions options;
  options.hole_limit = hole_limit;
  options.close_holes = close_holes;
  py::gil_scoped_release unlocked;
  return prepare_surface(mesh, name, options);
}

py::array_t<bool> cap_faces(const Surface& surface) {
  py::array_t<bool> marks(static_cast<py::ssize_t>(surface.mesh.faces.size()));
  std::fill_n(marks.mutable_data(), marks.size(), false);
  std::copy(surface.is_cap.begin(), surface.is_cap.end(), marks.mutable_data());
  return marks;
}

py::tuple bind_closest(const Surface& surface, const Array<double>& points_in) {
  const std::vector<Vec3> points = to_points(points_in, "points");
  // Of what is no place nothing is the closest.
  for (std::size_t i = 0; i < points.size(); ++i)
    if (!is_finite(points[i]))
      throw InputError("points: point " + std::to_string(i) + " is not finite");
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

std::vector<std::int32_t> to_cells(const Array<std::int32_t>& cells) {
  check_columns(cells, "cells", 3);
  return {cells.data(), cells.data() + cells.size()};
}

LabelImage to_image(const Array<std::uint16_t>& labels, const Array<double>& to_index) {
  if (labels.ndim() != 3 || labels.size() == 0)
    throw InputError("labels: an array of shape (nx, ny, nz) is needed");
  if (to_index.ndim() != 2 || to_index.shape(0) != 3 || to_index.shape(1) != 4)
    throw InputError("to_index: an array of shape (3, 4) is needed");
  LabelImage image;
  image.labels.assign(labels.data(), labels.data() + labels.size());
  for (int axis = 0; axis < 3; ++axis) {
    const double* row = to_index.data() + 4 * axis;
    image.size[axis] = labels.shape(axis);
    image.axes[axis] = {row[0], row[1], row[2]};
    image.offset[axis] = row[3];
  }
  return image;
}

// A volume: a Surface, or (LabelImage, member labels).
Volume to_volume(const py::handle& given) {
  Volume volume;
  if (py::isinstance<Surface>(given)) {
    volume.surface = given.cast<const Surface*>();
    return volume;
  }
  const auto pair = given.cast<py::tuple>();
  volume.image = pair[0].cast<const LabelImage*>();
  volume.members.assign(std::size_t{1} << 16, 0);
  for (const auto label : pair[1].cast<std::vector<std::uint16_t>>()) volume.members[label] = 1;
  return volume;
}

py::dict tally_dict(const Tally& tally) {
  const auto counts = [](const std::vector<std::uint64_t>& values) {
    return to_array(std::vector<std::uint64_t>(values));
  };
  py::dict d;
  d["inside"] = counts(tally.inside);
  d["covered_twice"] = counts(tally.covered_twice);
  d["reversed"] = counts(tally.reversed);
  d["both"] = to_array(std::vector<std::uint64_t>(tally.both), tally.n);
  return d;
}

py::dict bind_voxelise(const py::object& skin, const Surface& outer_surface,
                       const Array<bool>& outer, const py::list& bones, const py::list& parts,
                       std::array<double, 3> origin, std::array<double, 3> voxel,
                       std::array<std::int64_t, 3> count, int samples,
                       const std::vector<Array<double>>& boundaries, double cap,
                       const std::vector<std::pair<std::array<double, 6>, double>>& local_caps,
                       std::array<double, 3> region_low, std::array<double, 3> region_high,
                       int bone_rank, const std::vector<int>& part_ranks,
                       const std::vector<int>& layer_ranks) {
  const TriangleMesh& mesh = outer_surface.mesh;
  if (outer.ndim() != 1 || static_cast<std::size_t>(outer.shape(0)) != mesh.faces.size())
    throw InputError("outer: one value per skin face is needed");
  if (part_ranks.size() != parts.size() || layer_ranks.size() != boundaries.size() + 1)
    throw InputError("ranks: one per part and layer is needed");
  VoxeliseInput input;
  input.grid = {to_vec3(origin), to_vec3(voxel), count};
  input.samples = samples;
  input.skin = to_volume(skin);
  input.outer.vertices = mesh.vertices;
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    if (outer.data()[f]) input.outer.faces.push_back(mesh.faces[f]);
  for (const auto& bone : bones) input.bones.push_back(to_volume(bone));
  for (const auto& part : parts) input.parts.push_back(to_volume(part));
  for (const auto& layer : boundaries) {
    if (layer.size() != 1 && static_cast<std::size_t>(layer.size()) != mesh.vertices.size())
      throw InputError("boundaries: one value, or one per skin vertex, is needed");
    input.boundaries.emplace_back(layer.data(), layer.data() + layer.size());
  }
  input.cap = cap;
  for (const auto& [box, depth] : local_caps)
    input.local_caps.push_back({{{box[0], box[1], box[2]}, {box[3], box[4], box[5]}}, depth});
  input.region = {to_vec3(region_low), to_vec3(region_high)};
  input.bone_rank = bone_rank;
  input.part_ranks = part_ranks;
  input.layer_ranks = layer_ranks;
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
  d["inner"] = to_array(std::move(voxels.inner));
  d["too_deep"] = voxels.too_deep;
  d["tally"] = tally_dict(voxels.tally);
  return d;
}

py::array_t<double> bind_gaps(const std::vector<const Surface*>& surfaces,
                              std::array<double, 3> origin, std::array<double, 3> voxel,
                              const Array<std::int32_t>& cells_in, double width) {
  const auto cells = to_cells(cells_in);
  std::vector<double> volumes;
  {
    py::gil_scoped_release unlocked;
    volumes = gap_volumes(surfaces, to_vec3(origin), to_vec3(voxel), cells, width);
  }
  return to_array(std::move(volumes), surfaces.size());
}

py::tuple bind_clean(const Array<std::int32_t>& cells_in, int min_neighbours, bool largest_only) {
  const auto cells = to_cells(cells_in);
  CleanedCells cleaned;
  {
    py::gil_scoped_release unlocked;
    cleaned = clean_cells(cells, min_neighbours, largest_only);
  }
  py::array_t<bool> keep(static_cast<py::ssize_t>(cleaned.keep.size()));
  std::copy(cleaned.keep.begin(), cleaned.keep.end(), keep.mutable_data());
  return py::make_tuple(keep, cleaned.loose, cleaned.smaller);
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
      .def_property_readonly("is_cap", &cap_faces, "faces that close a hole above the limit")
      .def_property_readonly("report", [](const Surface& s) { return report_dict(s.report); })
      .def("closest_points", &bind_closest, py::arg("points"),
           "Squared distance (m^2), face, closest point and side (+1 outside) of (n, 3) points.");
  module.def("prepare_surface", &bind_prepare, py::arg("vertices"), py::arg("faces"),
             py::arg("name"), py::arg("hole_limit") = SurfaceOptions{}.hole_limit,
             py::arg("close_holes") = false,
             "Checks, welds, orients and closes a triangle surface; raises InputError.");
  py::class_<LabelImage>(module, "LabelImage", "A labelled voxel image.")
      .def(py::init(&to_image), py::arg("labels"), py::arg("to_index"),
           "labels (nx, ny, nz) uint16; to_index (3, 4): voxel index of a point in metres.");
  module.def("voxelise", &bind_voxelise, py::kw_only(), py::arg("skin"), py::arg("outer_surface"),
             py::arg("outer"), py::arg("bones"), py::arg("parts"), py::arg("origin"),
             py::arg("voxel"), py::arg("count"), py::arg("samples"), py::arg("boundaries"),
             py::arg("cap"), py::arg("local_caps"), py::arg("region_low"), py::arg("region_high"),
             py::arg("bone_rank"), py::arg("part_ranks"), py::arg("layer_ranks"),
             "Samples volumes into voxels: cells, shares, first, second, normal, inner, too_deep, "
             "tally.");
  module.def("gap_volumes", &bind_gaps, py::arg("surfaces"), py::arg("origin"), py::arg("voxel"),
             py::arg("cells"), py::arg("width"),
             "Volume (m3) of gaps between each two surfaces, the last of which is the skin.");
  module.def("clean_cells", &bind_clean, py::arg("cells"), py::arg("min_neighbours"),
             py::arg("largest_only"),
             "Keep mask, number of loose cells removed, sizes of the parts but the largest.");
}
