// Faces that are given more than once.
#pragma once
#include <cstddef>

#include "mesh/triangle_mesh.hpp"

namespace tledface {

// Keeps one face of each set of equal ones; opposite twins cancel where two closed parts touch.
// Needs sorted faces; returns how many were removed.
std::size_t remove_duplicates(TriangleMesh& mesh);

}  // namespace tledface
