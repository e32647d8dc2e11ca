// Faces that are given more than once.
#pragma once
#include <cstddef>

#include "mesh/triangle_mesh.hpp"

namespace tledface {

// Keeps one face of each set of equal ones; where two closed parts touch, opposite twins cancel,
// and where they coincide both stay.
// Needs sorted faces; returns how many were removed.
std::size_t remove_duplicates(TriangleMesh& mesh);

}  // namespace tledface
