// The places of which a corner is nearer than all else of the triangles about it: a cone.
#pragma once
#include <vector>

#include "mesh/vec3.hpp"

namespace tledface {

// Empty: there is no room in it. Else its edges' unit directions from the corner, the middle of
// them, and which of `edges` bound it.
struct CornerCone {
  std::vector<Vec3> rays;
  Vec3 middle;
  std::vector<std::size_t> bounds;
};

// edges: unit directions from the corner to the others of the triangles about it. A place is
// nearest to the corner where it lies behind it along each of them: the polar cone of the edges.
CornerCone corner_cone(const std::vector<Vec3>& edges);

}  // namespace tledface
