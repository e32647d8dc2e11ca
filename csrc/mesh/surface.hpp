// From a user's triangles to a closed, oriented, canonical surface, or a clear error.
#pragma once
#include <cstdint>
#include <string>
#include <vector>

#include "mesh/triangle_mesh.hpp"

namespace tledface {

struct SurfaceOptions {
  // Holes are filled while their perimeter is at most this fraction of the bounding box's diagonal.
  double hole_limit = 0.1;
  // If equal vertices alone leave open edges, vertices this near (fraction of the diagonal) are
  // joined too: files often write the two sides of a seam with different rounding.
  double seam_tolerance = 1e-5;
  // Larger holes are closed too, as cuts: see Surface::caps. Otherwise they are an error.
  bool close_holes = false;
};

// What was found and repaired. Counts, lengths in metres.
struct SurfaceReport {
  std::size_t vertices_read = 0, faces_read = 0;
  std::size_t vertices_welded = 0;   // read minus kept
  std::size_t degenerate_faces = 0;  // removed: two corners alike
  std::size_t duplicate_faces = 0;   // removed: repeated, or cancelled by an opposite twin
  std::size_t flipped_faces = 0;     // wound against their neighbours, or components inside out
  std::size_t inverted_components = 0;
  std::size_t cavities = 0;  // inward components inside another: kept as holes
  std::size_t components = 0;
  std::size_t open_edges = 0;    // before filling
  std::size_t holes_filled = 0;  // up to the limit
  std::size_t holes_closed = 0;  // above it
  double largest_hole = 0;       // perimeter
  // Half balls of the holes' perimeters, m^3: what the filling is hardly off by more than.
  double hole_volume = 0;
  bool seams_joined = false;
};

struct Surface {
  std::string name;
  TriangleMesh mesh;  // canonical order (see weld), closed: directed edges cancel at every edge
  // The faces that close each hole above the limit, a fan about the middle of its rim. Where such a
  // hole is deep or ragged the fan may stray from the shape; whoever needs an inside there corrects
  // it by the fan's solid angle (voxel/columns.hpp). Those faces of `mesh` are no skin.
  std::vector<TriangleMesh> caps;
  std::vector<char> is_cap;  // per face of mesh; empty without caps
  VolumeMoments moments;
  double area = 0;  // m^2
  SurfaceReport report;
};

// Welds, removes degenerate and repeated faces, orients each component (inward ones are turned
// unless they lie inside another, where they bound a cavity), fills small holes, and large ones
// where asked. Raises InputError, naming `name`, for an empty mesh, a non-finite vertex or one that
// does not exist, a surface that cannot be oriented, a hole above the limit, no volume.
Surface prepare_surface(const TriangleMesh& input, const std::string& name,
                        const SurfaceOptions& options = {});

}  // namespace tledface
