// NumPy arrays to the core's vectors and back, for the binding files.
#pragma once
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <cstdint>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "mesh/triangle_mesh.hpp"

namespace tledface {

namespace py = pybind11;

template <class T>
using Array = py::array_t<T, py::array::c_style | py::array::forcecast>;

template <class T>
void check_columns(const Array<T>& array, const char* name, py::ssize_t columns) {
  if (array.ndim() != 2 || array.shape(1) != columns)
    throw InputError(std::string(name) + ": an array of shape (n, " + std::to_string(columns) +
                     ") is needed");
}

inline std::vector<Vec3> to_points(const Array<double>& array, const char* name) {
  check_columns(array, name, 3);
  std::vector<Vec3> points(static_cast<std::size_t>(array.shape(0)));
  const double* data = array.data();
  for (std::size_t i = 0; i < points.size(); ++i)
    points[i] = {data[3 * i], data[3 * i + 1], data[3 * i + 2]};
  return points;
}

inline TriangleMesh to_mesh(const Array<double>& vertices, const Array<std::int32_t>& faces) {
  check_columns(faces, "faces", 3);
  TriangleMesh mesh;
  mesh.vertices = to_points(vertices, "vertices");
  mesh.faces.resize(static_cast<std::size_t>(faces.shape(0)));
  const std::int32_t* data = faces.data();
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    mesh.faces[f] = {data[3 * f], data[3 * f + 1], data[3 * f + 2]};
  return mesh;
}

// Hands a vector's memory to NumPy without a copy; columns 0 makes a flat array.
template <class T>
py::array_t<T> to_array(std::vector<T>&& values, std::size_t columns = 0) {
  auto* owner = new std::vector<T>(std::move(values));
  const py::capsule release(owner, [](void* p) { delete static_cast<std::vector<T>*>(p); });
  if (columns == 0)
    return py::array_t<T>(static_cast<py::ssize_t>(owner->size()), owner->data(), release);
  return py::array_t<T>({owner->size() / columns, columns}, owner->data(), release);
}

inline py::array_t<double> points_array(const std::vector<Vec3>& points) {
  std::vector<double> flat;
  flat.reserve(3 * points.size());
  for (const Vec3& p : points) flat.insert(flat.end(), {p.x, p.y, p.z});
  return to_array(std::move(flat), 3);
}

inline py::array_t<std::int32_t> faces_array(const std::vector<Face>& faces) {
  std::vector<std::int32_t> flat;
  flat.reserve(3 * faces.size());
  for (const Face& face : faces) flat.insert(flat.end(), face.begin(), face.end());
  return to_array(std::move(flat), 3);
}

}  // namespace tledface
