// The triangles of a surface that lie near some points: what nodes may come to in a run.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "broad_phase/uniform_grid.hpp"

namespace tledface {

// Of each triangle of a surface whether its box comes within `margin` of a point along each axis;
// of those up to a quarter farther some are taken, too. Points as the triangles' positions are, m.
std::vector<std::uint8_t> triangles_near(const SurfaceGrids& surfaces, std::size_t surface,
                                         const std::vector<Vec3>& points, double margin);

}  // namespace tledface
