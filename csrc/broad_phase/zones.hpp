// The places of which a face, an edge or a corner of a surface is known to be the nearest part, as
// the sliding kernels read them (kernels_cl/sliding_zone.cl). A node that stays in its zone needs
// no search, and one that leaves it through a border mostly enters the zone behind.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "broad_phase/uniform_grid.hpp"

namespace tledface {

struct Zones {
  std::vector<double> reals;              // units of ZONE_UNIT; a zone is known by its first
  std::vector<std::int32_t> of_triangle;  // TRIANGLE_ZONES a triangle; -1: none
};

// reach: of each surface how far before and behind it nodes are, m; 0: none. wanted: of each
// triangle of each surface whether there are to be zones of it; empty: of all. rounding: share of a
// coordinate that is nothing. Zones are convex and do not overlap, but they need not fill space.
Zones make_zones(const SurfaceGrids& surfaces, const std::vector<std::array<double, 2>>& reach,
                 const std::vector<std::vector<std::uint8_t>>& wanted, double rounding);

}  // namespace tledface
