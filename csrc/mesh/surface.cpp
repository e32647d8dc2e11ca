// Checks and repairs of a user's surface. See surface.hpp.
#include "mesh/surface.hpp"

#include <cstdio>
#include <map>
#include <memory>
#include <numeric>
#include <set>
#include <utility>

#include "core/error.hpp"
#include "mesh/bvh.hpp"
#include "mesh/duplicates.hpp"
#include "mesh/scanline.hpp"

namespace tledface {
namespace {

// A volume below this fraction of the box diagonal cubed counts as none (rounding of a flat sheet).
constexpr double kNoVolume = 1e-9;
constexpr double kMostHoles = 0.9;  // area of what closes holes over that of the faces given
constexpr double kPi = 3.14159265358979323846;
constexpr double kFarthest = 1e6;  // m; beyond it a vertex is damage, not anatomy

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", value);
  return text;
}

std::string millimetres(double value) { return number(1e3 * value) + " mm"; }

void check_input(const TriangleMesh& mesh, const std::string& name) {
  if (mesh.vertices.empty() || mesh.faces.empty())
    throw InputError(name + ": no triangles (" + std::to_string(mesh.vertices.size()) +
                     " vertices, " + std::to_string(mesh.faces.size()) +
                     " faces); a closed triangle surface is needed, export it again");
  for (std::size_t v = 0; v < mesh.vertices.size(); ++v)
    if (!is_finite(mesh.vertices[v]) || norm(mesh.vertices[v]) > kFarthest) {
      const Vec3& p = mesh.vertices[v];
      throw InputError(name + ": vertex " + std::to_string(v) + " is (" + number(p.x) + ", " +
                       number(p.y) + ", " + number(p.z) +
                       ") m, coordinates must be finite and below " + number(kFarthest) +
                       " m; repair or remove it");
    }
  const auto n = static_cast<std::int64_t>(mesh.vertices.size());
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    for (const std::int64_t v : mesh.faces[f])
      if (v < 0 || v >= n)
        throw InputError(name + ": face " + std::to_string(f) + " names vertex " +
                         std::to_string(v) + ", allowed are 0 to " + std::to_string(n - 1));
}

struct Components {
  std::vector<std::int32_t> of_face;
  std::int32_t count = 0;
};

void flip(Face& face) { std::swap(face[1], face[2]); }

// Groups faces that share an edge of exactly two faces, turning those wound against the group;
// the group keeps the winding of the larger part of its area. Returns the number of faces turned.
std::size_t orient_components(TriangleMesh& mesh, Components& components, const std::string& name) {
  const std::vector<Side> sides = sorted_sides(mesh);
  struct Neighbour {
    std::int32_t face = -1;
    bool agrees = true;
  };
  std::vector<std::array<Neighbour, 3>> neighbours(mesh.faces.size());
  std::vector<int> n_neighbours(mesh.faces.size(), 0);
  for (std::size_t begin = 0, end; begin < sides.size(); begin = end) {
    for (end = begin; end < sides.size() && sides[end].low == sides[begin].low &&
                      sides[end].high == sides[begin].high;
         ++end) {
    }
    if (end - begin != 2) continue;
    const Side &s = sides[begin], &t = sides[begin + 1];
    const bool agrees = s.direction != t.direction;
    neighbours[s.face][n_neighbours[s.face]++] = {t.face, agrees};
    neighbours[t.face][n_neighbours[t.face]++] = {s.face, agrees};
  }
  std::size_t turned = 0;
  components.of_face.assign(mesh.faces.size(), -1);
  components.count = 0;
  std::vector<char> reversed(mesh.faces.size(), 0);
  std::vector<std::int32_t> members;
  for (std::size_t seed = 0; seed < mesh.faces.size(); ++seed) {
    if (components.of_face[seed] >= 0) continue;
    members.assign(1, static_cast<std::int32_t>(seed));
    components.of_face[seed] = components.count;
    double balance = 0;  // area as found minus area reversed
    for (std::size_t m = 0; m < members.size(); ++m) {
      const std::int32_t f = members[m];
      const Face& face = mesh.faces[f];
      const Vec3& a = mesh.vertices[face[0]];
      const double area = norm(cross(mesh.vertices[face[1]] - a, mesh.vertices[face[2]] - a));
      balance += reversed[f] ? -area : area;
      for (int i = 0; i < n_neighbours[f]; ++i) {
        const Neighbour& other = neighbours[f][i];
        const char wanted = reversed[f] ^ static_cast<char>(!other.agrees);
        if (components.of_face[other.face] < 0) {
          components.of_face[other.face] = components.count;
          reversed[other.face] = wanted;
          members.push_back(other.face);
        } else if (reversed[other.face] != wanted) {
          throw InputError(name +
                           ": the surface cannot be oriented (one side runs into the other "
                           "near face " +
                           std::to_string(f) +
                           " after welding); a closed two-sided surface is needed, rebuild it");
        }
      }
    }
    for (const auto f : members)
      if ((balance < 0) != static_cast<bool>(reversed[f])) {
        flip(mesh.faces[f]);
        ++turned;
      }
    ++components.count;
  }
  return turned;
}

// Joins edge-connected groups that are open by themselves but balance each other (non-manifold
// edges), so that volumes are taken of closed sets: groups sharing an unbalanced vertex pair.
void merge_groups(const TriangleMesh& mesh, Components& components) {
  std::vector<std::int32_t> parent(components.count);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](std::int32_t c) {
    while (parent[c] != c) c = parent[c] = parent[parent[c]];
    return c;
  };
  const std::vector<Side> sides = sorted_sides(mesh);
  for (std::size_t s = 1; s < sides.size(); ++s)
    if (sides[s].low == sides[s - 1].low && sides[s].high == sides[s - 1].high) {
      const std::int32_t a = root(components.of_face[sides[s - 1].face]);
      const std::int32_t b = root(components.of_face[sides[s].face]);
      parent[std::max(a, b)] = std::min(a, b);
    }
  std::vector<std::int32_t> number(components.count, -1);
  std::int32_t count = 0;
  for (std::int32_t c = 0; c < components.count; ++c)
    if (root(c) == c) number[c] = count++;
  for (auto& c : components.of_face) c = number[root(c)];
  components.count = count;
}

// Directed edges of faces without an opposite partner, as loops of vertices. The boundary of any
// set of faces enters and leaves each vertex equally often, so walks always close.
std::vector<std::vector<std::int32_t>> boundary_loops(const TriangleMesh& mesh) {
  const std::vector<Side> sides = sorted_sides(mesh);
  std::map<std::int32_t, std::vector<std::int32_t>> next;
  for (std::size_t begin = 0, end; begin < sides.size(); begin = end) {
    int net = 0;
    for (end = begin; end < sides.size() && sides[end].low == sides[begin].low &&
                      sides[end].high == sides[begin].high;
         ++end)
      net += sides[end].direction;
    const Side& side = sides[begin];
    for (int n = 0; n < std::abs(net); ++n)
      next[net > 0 ? side.low : side.high].push_back(net > 0 ? side.high : side.low);
  }
  std::vector<std::vector<std::int32_t>> loops;
  std::map<std::int32_t, std::size_t> place;  // in the path
  std::vector<std::int32_t> path;
  while (!next.empty()) {
    if (path.empty()) {
      path.push_back(next.begin()->first);
      place[path.back()] = 0;
    }
    const auto out = next.find(path.back());
    const std::int32_t v = out->second.back();
    out->second.pop_back();
    if (out->second.empty()) next.erase(out);
    const auto seen = place.find(v);
    if (seen == place.end()) {
      place[v] = path.size();
      path.push_back(v);
      continue;
    }
    const std::size_t from = seen->second;
    loops.emplace_back(path.begin() + static_cast<std::ptrdiff_t>(from), path.end());
    for (std::size_t p = from + 1; p < path.size(); ++p) place.erase(path[p]);
    path.resize(from + 1);
    if (from == 0) {
      path.clear();
      place.clear();
    }
  }
  return loops;
}

// Closes the holes; returns the first and the end of the faces that close each one above the limit.
std::vector<std::array<std::size_t, 2>> fill_holes(TriangleMesh& mesh, const std::string& name,
                                                   double diagonal, const SurfaceOptions& options,
                                                   SurfaceReport& report) {
  const auto loops = boundary_loops(mesh);
  std::vector<double> perimeters;
  for (const auto& loop : loops) {
    report.open_edges += loop.size();
    double perimeter = 0;
    for (std::size_t i = 0; i < loop.size(); ++i)
      perimeter += norm(mesh.vertices[loop[(i + 1) % loop.size()]] - mesh.vertices[loop[i]]);
    perimeters.push_back(perimeter);
    report.largest_hole = std::max(report.largest_hole, perimeter);
    report.hole_volume += perimeter * perimeter * perimeter / (12 * kPi * kPi);
  }
  const double limit = options.hole_limit * diagonal;
  if (report.largest_hole > limit && !options.close_holes)
    throw InputError(name + ": the surface is open: " + std::to_string(report.open_edges) +
                     " open edges in " + std::to_string(loops.size()) +
                     (loops.size() == 1 ? " hole, " : " holes, the largest ") +
                     millimetres(report.largest_hole) + " around; holes up to " +
                     millimetres(limit) + " (" + number(100 * options.hole_limit) +
                     " % of the size) are filled, close the larger ones in a mesh editor, or take "
                     "holes = \"close\"");
  const double own_area = surface_area(mesh);
  std::vector<std::array<std::size_t, 2>> caps;
  for (std::size_t l = 0; l < loops.size(); ++l) {
    const auto& loop = loops[l];
    const bool large = perimeters[l] > limit;
    ++(large ? report.holes_closed : report.holes_filled);
    const std::size_t begin = mesh.faces.size();
    // Fill faces run against the open edges.
    if (loop.size() == 3) {
      mesh.faces.push_back({loop[0], loop[2], loop[1]});
    } else {
      Vec3 sum;
      for (const auto v : loop) sum = sum + mesh.vertices[v];
      const auto centre = static_cast<std::int32_t>(mesh.vertices.size());
      mesh.vertices.push_back((1.0 / static_cast<double>(loop.size())) * sum);
      for (std::size_t i = 0; i < loop.size(); ++i)
        mesh.faces.push_back({loop[(i + 1) % loop.size()], loop[i], centre});
    }
    if (large) caps.push_back({begin, mesh.faces.size()});
  }
  // Scattered patches are each closed by about their own area and hold nothing.
  if (surface_area(mesh) - own_area > kMostHoles * own_area)
    throw InputError(name + ": the surface is open: its " + std::to_string(loops.size()) +
                     " holes are as large as itself, so that it says no shape; close them in a "
                     "mesh editor");
  return caps;
}

// A face by the places of its corners, which a renumbering does not change.
std::array<Vec3, 3> places(const TriangleMesh& mesh, const Face& face) {
  std::array<Vec3, 3> corners{mesh.vertices[face[0]], mesh.vertices[face[1]],
                              mesh.vertices[face[2]]};
  std::sort(corners.begin(), corners.end());
  return corners;
}

// Keeps the faces that close large holes, now that they are turned the right way.
void take_caps(const TriangleMesh& mesh, const std::vector<std::array<std::size_t, 2>>& ranges,
               Surface& surface) {
  for (const auto& [begin, end] : ranges) {
    TriangleMesh cap;
    for (std::size_t f = begin; f < end; ++f) {
      const auto first = static_cast<std::int32_t>(cap.vertices.size());
      for (const auto v : mesh.faces[f]) cap.vertices.push_back(mesh.vertices[v]);
      cap.faces.push_back({first, first + 1, first + 2});
    }
    surface.caps.push_back(std::move(cap));
  }
}

void mark_caps(Surface& surface) {
  std::set<std::array<Vec3, 3>> capped;
  for (const TriangleMesh& cap : surface.caps)
    for (const Face& face : cap.faces) capped.insert(places(cap, face));
  for (const Face& face : surface.mesh.faces)
    surface.is_cap.push_back(static_cast<char>(capped.count(places(surface.mesh, face))));
}

// Turns the whole surface if it is inside out as a whole, so that its cavities stay cavities; then
// components of negative volume, unless they lie within another one.
void turn_inverted(TriangleMesh& mesh, const Components& components, SurfaceReport& report) {
  std::vector<std::vector<std::int32_t>> members(components.count);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f)
    members[components.of_face[f]].push_back(static_cast<std::int32_t>(f));
  if (volume_moments(mesh).volume < 0) {
    report.inverted_components += static_cast<std::size_t>(components.count);
    report.flipped_faces += mesh.faces.size();
    for (Face& face : mesh.faces) flip(face);
  }
  const Vec3 origin = mesh.vertices[mesh.faces[0][0]];
  std::unique_ptr<Bvh> tree;
  for (std::int32_t c = 0; c < components.count; ++c) {
    double volume = 0;
    for (const auto f : members[c]) {
      const Face& face = mesh.faces[f];
      volume += dot(mesh.vertices[face[0]] - origin,
                    cross(mesh.vertices[face[1]] - origin, mesh.vertices[face[2]] - origin));
    }
    if (volume >= 0) continue;
    constexpr std::size_t kProbes = 16;
    const std::size_t stride = members[c].size() / kProbes + 1;
    // By the most of the probes: damage may drag a corner of a cavity out through the wall.
    int n_probes = 0, n_within = 0;
    if (components.count > 1 && !tree) tree = std::make_unique<Bvh>(mesh);
    for (std::size_t m = 0; tree && m < members[c].size(); m += stride) {
      const Face& face = mesh.faces[members[c][m]];
      const Vec3 probe =
          (1.0 / 3) * (mesh.vertices[face[0]] + mesh.vertices[face[1]] + mesh.vertices[face[2]]);
      int winding = 0;
      tree->visit_column(probe.x, probe.y, [&](std::int32_t f) {
        if (components.of_face[f] != c)
          winding += winding_of_face(tree->mesh(), tree->mesh().faces[f], probe);
      });
      ++n_probes;
      n_within += winding != 0;
    }
    const bool within = 2 * n_within > n_probes;
    if (within) {
      ++report.cavities;
      continue;
    }
    ++report.inverted_components;
    report.flipped_faces += members[c].size();
    for (const auto f : members[c]) flip(mesh.faces[f]);
  }
}

}  // namespace

Surface prepare_surface(const TriangleMesh& input, const std::string& name,
                        const SurfaceOptions& options) {
  check_input(input, name);
  Surface surface;
  surface.name = name;
  SurfaceReport& report = surface.report;
  report.vertices_read = input.vertices.size();
  report.faces_read = input.faces.size();
  const Bounds box = bounds(input);
  const double diagonal = norm(box.high - box.low);

  TriangleMesh& mesh = surface.mesh;
  mesh = weld(input, 0);
  const auto open = [](const TriangleMesh& m) {
    return !m.faces.empty() && !boundary_loops(m).empty();
  };
  if (open(mesh)) {
    TriangleMesh joined = weld(input, options.seam_tolerance * diagonal);
    if (joined.vertices.size() < mesh.vertices.size() && !joined.faces.empty()) {
      mesh = std::move(joined);
      report.seams_joined = true;
    }
  }
  report.vertices_welded = report.vertices_read - mesh.vertices.size();
  report.degenerate_faces = report.faces_read - mesh.faces.size();
  report.duplicate_faces = remove_duplicates(mesh);
  if (mesh.faces.empty())
    throw InputError(name + ": all " + std::to_string(report.faces_read) +
                     " faces are degenerate or cancel each other; a closed triangle surface is "
                     "needed, export it again");

  Components components;
  report.flipped_faces = orient_components(mesh, components, name);
  const auto caps = fill_holes(mesh, name, diagonal, options, report);
  report.flipped_faces += orient_components(mesh, components, name);
  merge_groups(mesh, components);
  report.components = static_cast<std::size_t>(components.count);
  turn_inverted(mesh, components, report);
  take_caps(mesh, caps, surface);
  mesh = weld(mesh, 0);
  if (!surface.caps.empty()) mark_caps(surface);

  surface.area = surface_area(mesh);
  surface.moments = volume_moments(mesh);
  if (!(surface.moments.volume > kNoVolume * diagonal * diagonal * diagonal))
    throw InputError(name + ": the surface encloses no volume (" +
                     number(1e9 * surface.moments.volume) + " mm3 in a box of diagonal " +
                     millimetres(diagonal) + "); a closed surface of a solid is needed");
  return surface;
}

}  // namespace tledface
