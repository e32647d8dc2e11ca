// Slabs of cells along x, each worked by one thread. See fibre_samples.hpp.
#include "voxel/fibre_samples.hpp"

#include <string>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "mesh/scanline.hpp"

namespace tledface {
namespace {

void work_slab(const ColumnScanner& scanner, const VoxelGrid& grid, int n, std::int64_t i,
               CellSamples& out) {
  if (!scanner.reaches(i)) return;
  SlabCrossings crossings;
  scanner.scan(i, crossings);
  const std::int64_t n_columns = grid.count[1] * n, n_samples = grid.count[2] * n;
  const std::size_t cell_size = static_cast<std::size_t>(n) * n * n;
  std::vector<std::uint8_t> column(cell_size * grid.count[2]);
  std::vector<std::uint8_t> any(grid.count[2]);
  for (std::int64_t j = 0; j < grid.count[1]; ++j) {
    std::fill(column.begin(), column.end(), 0);
    std::fill(any.begin(), any.end(), 0);
    for (int a = 0; a < n; ++a)
      for (int b = 0; b < n; ++b) {
        const std::size_t row = static_cast<std::size_t>(a * n_columns + j * n + b);
        const std::uint32_t end = crossings.begin[row + 1];
        int winding = 0;
        for (std::uint32_t item = crossings.begin[row]; item < end; ++item) {
          winding += crossings.items[item].sign;
          if (winding == 0) continue;
          const std::int64_t to = item + 1 < end ? crossings.items[item + 1].sample : n_samples;
          for (std::int64_t z = crossings.items[item].sample; z < to; ++z) {
            column[cell_size * (z / n) + static_cast<std::size_t>((a * n + b) * n + z % n)] = 1;
            any[z / n] = 1;
          }
        }
      }
    for (std::int64_t k = 0; k < grid.count[2]; ++k) {
      if (!any[k]) continue;
      for (const auto index : {i, j, k}) out.cells.push_back(static_cast<std::int32_t>(index));
      const auto first = column.begin() + static_cast<std::ptrdiff_t>(cell_size) * k;
      out.inside.insert(out.inside.end(), first, first + static_cast<std::ptrdiff_t>(cell_size));
    }
  }
}

}  // namespace

CellSamples samples_inside(const TriangleMesh& surface, const VoxelGrid& grid, int samples) {
  if (samples < 1 || samples > kMaxSamples)
    throw InputError("samples: got " + std::to_string(samples) + ", allowed is 1 to " +
                     std::to_string(kMaxSamples) + " a cell edge");
  SampleLattice lattice;
  lattice.step = (1.0 / samples) * grid.voxel;
  lattice.first = grid.origin + 0.5 * lattice.step;
  for (int axis = 0; axis < 3; ++axis) lattice.count[axis] = grid.count[axis] * samples;
  const ColumnScanner scanner(surface, lattice, samples);
  std::vector<CellSamples> slabs(static_cast<std::size_t>(grid.count[0]));
  parallel_for(slabs.size(), [&](std::size_t i) {
    work_slab(scanner, grid, samples, static_cast<std::int64_t>(i), slabs[i]);
  });
  CellSamples result;
  for (const CellSamples& slab : slabs) {
    result.cells.insert(result.cells.end(), slab.cells.begin(), slab.cells.end());
    result.inside.insert(result.inside.end(), slab.inside.begin(), slab.inside.end());
  }
  return result;
}

}  // namespace tledface
