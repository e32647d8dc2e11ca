// Sets of grid cells: loose cells and unconnected parts.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace tledface {

struct CleanedCells {
  std::vector<char> keep;            // per cell
  std::size_t loose = 0;             // removed: too few face neighbours
  std::vector<std::size_t> smaller;  // sizes of the face-connected parts but the largest, falling
};

// Removes cells with fewer than min_neighbours face neighbours until none is left (0: keeps all),
// then, if largest_only, all but the largest face-connected part (of equal ones the first). Cells
// in lexicographic order, 3 indices each.
CleanedCells clean_cells(const std::vector<std::int32_t>& cells, int min_neighbours,
                         bool largest_only);

}  // namespace tledface
