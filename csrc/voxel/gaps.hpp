// Places where two volumes nearly touch: tissue thinner than a voxel between them.
#pragma once
#include <cstdint>
#include <vector>

#include "mesh/surface.hpp"

namespace tledface {

// Volume (m^3) of the gaps between surfaces p < q, at p * n + q for n surfaces, the last of which
// is the skin, whose inside counts as outside of it. A place lies in a gap if it is in no volume,
// the ways to the closest points of both are opposed, and together they are at most `width` long
// (m). Sampled 2^3 times in each of the given cells of the grid (3 indices each).
std::vector<double> gap_volumes(const std::vector<const Surface*>& surfaces, const Vec3& origin,
                                const Vec3& voxel, const std::vector<std::int32_t>& cells,
                                double width);

}  // namespace tledface
