// Repeated faces, by sheets of equal corners. See duplicates.hpp.
#include "mesh/duplicates.hpp"

#include <algorithm>
#include <cstdlib>
#include <numeric>

namespace tledface {
namespace {

// A face, whatever its winding: its copies, and how many wind forwards less backwards.
struct Sheet {
  Face face;
  int copies, net;
};

// How many copies of each sheet to keep. Where two closed parts touch or coincide, the rim of the
// repeated sheets has two single faces at each edge: opposite twins cancel, equal ones both stay. A
// face given twice by mistake has one, and one copy of it stays, whichever way the other is wound.
// Neighbouring repeated sheets are judged together, by the most of their edges. Without single
// faces at its edges a group is a surface given several times if it is closed, else a flake.
std::vector<int> copies_to_keep(const std::vector<Sheet>& sheets) {
  TriangleMesh all;
  for (const Sheet& sheet : sheets) all.faces.push_back(sheet.face);
  const std::vector<Side> sides = sorted_sides(all);
  std::vector<std::int32_t> parent(sheets.size());
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](std::int32_t f) {
    while (parent[f] != f) f = parent[f] = parent[parent[f]];
    return f;
  };
  // Calls visit(first side, end, single sheets, a repeated one) for each edge with a repeated one.
  const auto for_edges = [&](auto visit) {
    for (std::size_t begin = 0, end; begin < sides.size(); begin = end) {
      std::size_t singles = 0;
      std::int32_t repeated = -1;
      for (end = begin; end < sides.size() && sides[end].low == sides[begin].low &&
                        sides[end].high == sides[begin].high;
           ++end)
        if (sheets[sides[end].face].copies == 1)
          ++singles;
        else
          repeated = sides[end].face;
      if (repeated >= 0) visit(begin, end, singles, repeated);
    }
  };
  for_edges([&](std::size_t begin, std::size_t end, std::size_t, std::int32_t repeated) {
    for (std::size_t s = begin; s < end; ++s)
      if (sheets[sides[s].face].copies > 1) {
        const std::int32_t p = root(sides[s].face), q = root(repeated);
        parent[std::max(p, q)] = std::min(p, q);
      }
  });
  struct Votes {
    int one = 0, even = 0;
  };
  std::vector<Votes> votes(sheets.size());
  for_edges([&](std::size_t begin, std::size_t end, std::size_t singles, std::int32_t repeated) {
    Votes& of_group = votes[root(repeated)];
    if (singles % 2 == 1)
      ++of_group.one;
    else if ((end - begin - singles) % 2 == 1)
      ++of_group.even;
  });
  std::vector<int> keep(sheets.size(), 1);
  for (std::size_t f = 0; f < sheets.size(); ++f) {
    if (sheets[f].copies == 1) continue;
    const Votes& of_group = votes[root(static_cast<std::int32_t>(f))];
    if (of_group.even >= of_group.one && of_group.even > 0)
      keep[f] = std::abs(sheets[f].net) / 2 * 2;
  }
  return keep;
}

}  // namespace

std::size_t remove_duplicates(TriangleMesh& mesh) {
  // Faces start at their lowest vertex, so the two windings differ in the order of the others.
  std::vector<Sheet> sheets;
  sheets.reserve(mesh.faces.size());
  for (const Face& face : mesh.faces)
    if (face[1] < face[2])
      sheets.push_back({face, 1, 1});
    else
      sheets.push_back({{face[0], face[2], face[1]}, 1, -1});
  std::sort(sheets.begin(), sheets.end(),
            [](const Sheet& p, const Sheet& q) { return p.face < q.face; });
  const std::size_t before = mesh.faces.size();
  std::size_t n = 0;
  for (std::size_t begin = 0, end; begin < before; begin = end) {
    Sheet joined = sheets[begin];
    for (end = begin + 1; end < before && sheets[end].face == joined.face; ++end) {
      ++joined.copies;
      joined.net += sheets[end].net;
    }
    sheets[n++] = joined;
  }
  sheets.resize(n);
  if (n == before) return 0;
  const std::vector<int> keep = copies_to_keep(sheets);
  mesh.faces.clear();
  for (std::size_t f = 0; f < n; ++f) {
    const Face& face = sheets[f].face;
    for (int copy = 0; copy < keep[f]; ++copy)
      mesh.faces.push_back(sheets[f].net >= 0 ? face : Face{face[0], face[2], face[1]});
  }
  sort_faces(mesh);
  return before - mesh.faces.size();
}

}  // namespace tledface
