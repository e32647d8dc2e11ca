// Column crossings of a surface, slab by slab. See scanline.hpp.
#include "mesh/scanline.hpp"

namespace tledface {
namespace {

// First lattice index at or above a coordinate, within [0, count].
std::int64_t index_at_or_above(double x, double first, double step, std::int64_t count) {
  const double index = std::ceil((x - first) / step);
  return static_cast<std::int64_t>(std::clamp(index, 0.0, static_cast<double>(count)));
}

}  // namespace

ColumnScanner::ColumnScanner(const TriangleMesh& mesh, const SampleLattice& lattice,
                             int rows_per_slab)
    : mesh_(mesh), lattice_(lattice), rows_(rows_per_slab) {
  const std::int64_t n_slabs = (lattice.count[0] + rows_ - 1) / rows_;
  const auto slabs = [&](const Face& face, std::int64_t& from, std::int64_t& to) {
    double low = mesh.vertices[face[0]].x, high = low;
    for (const auto v : face) {
      low = std::min(low, mesh.vertices[v].x);
      high = std::max(high, mesh.vertices[v].x);
    }
    // One row of margin each way: rounding must not lose a face, and a spare one costs a test.
    const double a = (low - lattice.first.x) / lattice.step.x - 1;
    const double b = (high - lattice.first.x) / lattice.step.x + 1;
    const double last = static_cast<double>(n_slabs);
    from = static_cast<std::int64_t>(std::clamp(std::floor(a / rows_), 0.0, last));
    to = static_cast<std::int64_t>(std::clamp(std::floor(b / rows_) + 1, 0.0, last));
  };
  begin_.assign(n_slabs + 1, 0);
  std::int64_t from, to;
  for (const Face& face : mesh.faces) {
    slabs(face, from, to);
    for (std::int64_t s = from; s < to; ++s) ++begin_[s + 1];
  }
  for (std::int64_t s = 0; s < n_slabs; ++s) begin_[s + 1] += begin_[s];
  faces_.resize(begin_[n_slabs]);
  std::vector<std::size_t> next(begin_.begin(), begin_.end() - 1);
  for (std::size_t f = 0; f < mesh.faces.size(); ++f) {
    slabs(mesh.faces[f], from, to);
    for (std::int64_t s = from; s < to; ++s) faces_[next[s]++] = static_cast<std::int32_t>(f);
  }
}

void ColumnScanner::scan(std::int64_t slab, SlabCrossings& out) const {
  const std::int64_t row_begin = slab * rows_;
  const std::int64_t row_end = std::min(row_begin + rows_, lattice_.count[0]);
  const std::int64_t n_columns = lattice_.count[1];
  auto& hits = out.hits_;
  hits.clear();
  LineCrossing low, high;
  for (std::size_t i = begin_[slab]; i < begin_[slab + 1]; ++i) {
    const Face& face = mesh_.faces[faces_[i]];
    for (std::int64_t row = row_begin; row < row_end; ++row) {
      const double x = lattice_.first.x + static_cast<double>(row) * lattice_.step.x;
      if (!cross_face(mesh_, face, x, low, high)) continue;
      const std::int64_t b_begin =
          index_at_or_above(low.y, lattice_.first.y, lattice_.step.y, n_columns);
      const std::int64_t b_end =
          index_at_or_above(high.y, lattice_.first.y, lattice_.step.y, n_columns);
      for (std::int64_t b = b_begin; b < b_end; ++b) {
        const double y = lattice_.first.y + static_cast<double>(b) * lattice_.step.y;
        const double t = std::clamp((y - low.y) / (high.y - low.y), 0.0, 1.0);
        const std::int64_t c = index_at_or_above(low.z + t * (high.z - low.z), lattice_.first.z,
                                                 lattice_.step.z, lattice_.count[2]);
        if (c == lattice_.count[2]) continue;
        hits.push_back({static_cast<std::uint32_t>((row - row_begin) * n_columns + b),
                        {static_cast<std::int32_t>(c), -low.direction}});
      }
    }
  }
  out.begin.assign(rows_ * n_columns + 1, 0);
  for (const auto& hit : hits) ++out.begin[hit.column + 1];
  for (std::size_t c = 1; c < out.begin.size(); ++c) out.begin[c] += out.begin[c - 1];
  out.items.resize(hits.size());
  for (const auto& hit : hits) out.items[out.begin[hit.column]++] = hit.crossing;
  for (std::size_t c = out.begin.size() - 1; c > 0; --c) out.begin[c] = out.begin[c - 1];
  out.begin[0] = 0;
  for (std::size_t c = 0; c + 1 < out.begin.size(); ++c)
    std::sort(out.items.begin() + out.begin[c], out.items.begin() + out.begin[c + 1],
              [](const Crossing& p, const Crossing& q) { return p.sample < q.sample; });
}

}  // namespace tledface
