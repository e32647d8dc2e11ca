// Repeated faces, by sheets of equal corners. See duplicates.hpp.
#include "mesh/duplicates.hpp"

#include <algorithm>
#include <numeric>

namespace tledface {
namespace {

// A face, whatever its winding, and how many copies of it wind forwards less backwards.
struct Sheet {
  Face face;
  int net;
};

// Which sheets of opposite twins (net 0) to keep. Twins that face each other, as where two closed
// parts touch, cancel: their rim has two faces of others at each edge, or none. A face given twice
// of which one copy was turned is part of the surface: its edges have one face of another. Groups
// of neighbouring twins are judged together, by the most of their edges; a group without others at
// its edges is a surface given from both sides if it is closed, else a flake.
std::vector<char> keep_twins(const std::vector<Sheet>& sheets) {
  TriangleMesh all;
  for (const Sheet& sheet : sheets) all.faces.push_back(sheet.face);
  const std::vector<Side> sides = sorted_sides(all);
  std::vector<std::int32_t> parent(sheets.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](std::int32_t f) {
    while (parent[f] != f) f = parent[f] = parent[parent[f]];
    return f;
  };
  const auto for_edges = [&](auto visit) {
    for (std::size_t begin = 0, end; begin < sides.size(); begin = end) {
      std::size_t others = 0;
      std::int32_t twin = -1;
      for (end = begin; end < sides.size() && sides[end].low == sides[begin].low &&
                        sides[end].high == sides[begin].high;
           ++end)
        if (sheets[sides[end].face].net != 0)
          ++others;
        else
          twin = sides[end].face;
      if (twin >= 0) visit(begin, end, others, twin);
    }
  };
  for_edges([&](std::size_t begin, std::size_t end, std::size_t, std::int32_t twin) {
    for (std::size_t s = begin; s < end; ++s)
      if (sheets[sides[s].face].net == 0) {
        const std::int32_t p = root(sides[s].face), q = root(twin);
        parent[std::max(p, q)] = std::min(p, q);
      }
  });
  struct Votes {
    int keep = 0, drop = 0;
  };
  std::vector<Votes> votes(sheets.size());
  for_edges([&](std::size_t begin, std::size_t end, std::size_t others, std::int32_t twin) {
    const std::size_t twins = end - begin - others;
    Votes& of_group = votes[root(twin)];
    if (others % 2 == 1)
      ++of_group.keep;
    else if (twins % 2 == 1)
      ++of_group.drop;
  });
  std::vector<char> keep(sheets.size(), 0);
  for (std::size_t f = 0; f < sheets.size(); ++f) {
    const Votes& of_group = votes[root(static_cast<std::int32_t>(f))];
    keep[f] = sheets[f].net != 0 || of_group.keep > of_group.drop ||
              (of_group.keep == 0 && of_group.drop == 0);
  }
  return keep;
}

}  // namespace

std::size_t remove_duplicates(TriangleMesh& mesh) {
  // Faces start at their lowest vertex, so the two windings differ in the order of the others.
  std::vector<Sheet> signed_faces;
  signed_faces.reserve(mesh.faces.size());
  for (const Face& face : mesh.faces)
    if (face[1] < face[2])
      signed_faces.push_back({face, 1});
    else
      signed_faces.push_back({{face[0], face[2], face[1]}, -1});
  std::sort(signed_faces.begin(), signed_faces.end(),
            [](const Sheet& p, const Sheet& q) { return p.face < q.face; });
  const std::size_t before = mesh.faces.size();
  std::vector<Sheet> sheets;
  bool any_twins = false;
  for (std::size_t begin = 0, end; begin < signed_faces.size(); begin = end) {
    Sheet sheet{signed_faces[begin].face, 0};
    for (end = begin; end < signed_faces.size() && signed_faces[end].face == sheet.face; ++end)
      sheet.net += signed_faces[end].net;
    any_twins = any_twins || sheet.net == 0;
    sheets.push_back(sheet);
  }
  const std::vector<char> keep =
      any_twins ? keep_twins(sheets) : std::vector<char>(sheets.size(), 1);
  mesh.faces.clear();
  for (std::size_t f = 0; f < sheets.size(); ++f) {
    const Face& face = sheets[f].face;
    if (keep[f]) mesh.faces.push_back(sheets[f].net >= 0 ? face : Face{face[0], face[2], face[1]});
  }
  sort_faces(mesh);
  return before - mesh.faces.size();
}

}  // namespace tledface
