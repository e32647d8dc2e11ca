// The triangles of surfaces as the sliding kernels read them (kernels_cl/sliding.cl): corners and
// normals, and a uniform grid of cells with the triangles whose boxes reach each. Built on the
// host, searched on the device. The brute-force twin is what tests compare the search with.
#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "mesh/triangle_mesh.hpp"

namespace tledface {

struct SurfaceGrids {
  std::vector<double> triangles;                   // TRIANGLE_REALS a triangle
  std::vector<std::int32_t> first_triangle = {0};  // of each surface, and the end
  std::vector<std::int32_t> grids;                 // GRID_INTS a surface
  std::vector<double> grid_reals;                  // GRID_REALS a surface
  std::vector<std::int32_t> cell_begin, cell_triangles;
};

// surfaces: oriented, vertices shared (weld). Positions become those relative to `centre`, with
// axis a of the result axis order[a] of the surfaces; normals stay outward whatever that does to
// the winding. Throws InputError for a surface without triangles of any area.
SurfaceGrids make_surface_grids(const std::vector<TriangleMesh>& surfaces, const Vec3& centre,
                                const std::array<int, 3>& order);

struct NearestTriangle {
  std::int32_t face = -1;
  double square = 0;  // squared distance, m^2
};

// Every triangle against every point, in float64; of equally near ones the lowest.
std::vector<NearestTriangle> nearest_by_brute_force(const TriangleMesh& surface,
                                                    const std::vector<Vec3>& points);

}  // namespace tledface
