// Columns of surfaces and of labelled images. See columns.hpp.
#include "voxel/columns.hpp"

namespace tledface {
namespace {

constexpr double kPi = 3.14159265358979323846;

using Range = std::array<std::int64_t, 2>;

// Lattice indices whose samples lie in [low, high] along an axis, one more on each side.
Range index_range(const SampleLattice& lattice, int axis, double low, double high) {
  const double first = lattice.first[axis], step = lattice.step[axis];
  const auto count = static_cast<double>(lattice.count[axis]);
  const double from = std::floor((low - first) / step), to = std::ceil((high - first) / step) + 1;
  return {static_cast<std::int64_t>(std::clamp(from, 0.0, count)),
          static_cast<std::int64_t>(std::clamp(to, 0.0, count))};
}

Vec3 sample_at(const SampleLattice& lattice, std::int64_t a, std::int64_t b, std::int64_t c) {
  return lattice.first + Vec3{static_cast<double>(a) * lattice.step.x,
                              static_cast<double>(b) * lattice.step.y,
                              static_cast<double>(c) * lattice.step.z};
}

class SurfaceColumns : public Columns {
 public:
  SurfaceColumns(const Surface& surface, const SampleLattice& lattice, int rows)
      : scanner_(surface.mesh, lattice, rows), lattice_(lattice), rows_(rows) {
    for (const TriangleMesh& cap : surface.caps) {
      const auto first = static_cast<std::int32_t>(caps_.vertices.size());
      caps_.vertices.insert(caps_.vertices.end(), cap.vertices.begin(), cap.vertices.end());
      for (const Face& face : cap.faces)
        caps_.faces.push_back({first + face[0], first + face[1], first + face[2]});
    }
    if (caps_.faces.empty()) return;
    const Bounds box = bounds(caps_);
    for (int axis = 0; axis < 3; ++axis)
      range_[axis] = index_range(lattice, axis, box.low[axis], box.high[axis]);
  }

  bool reaches(std::int64_t slab) const override { return scanner_.reaches(slab); }

  void scan(std::int64_t slab, SlabCrossings& out) const override {
    scanner_.scan(slab, out);
    if (range_[0][0] < (slab + 1) * rows_ && range_[0][1] > slab * rows_)
      decide_by_solid_angle(slab, out);
  }

 private:
  // Replaces the crossings of columns through the caps' box by those of its samples' own decision.
  void decide_by_solid_angle(std::int64_t slab, SlabCrossings& out) const {
    SlabCrossings decided;
    decided.begin.assign(1, 0);
    for (std::size_t column = 0; column + 1 < out.begin.size(); ++column) {
      const auto a = slab * rows_ + static_cast<std::int64_t>(column) / lattice_.count[1];
      const auto b = static_cast<std::int64_t>(column) % lattice_.count[1];
      const std::uint32_t begin = out.begin[column], end = out.begin[column + 1];
      if (a >= range_[0][0] && a < range_[0][1] && b >= range_[1][0] && b < range_[1][1])
        decide_column(a, b, out, begin, end, decided.items);
      else
        decided.items.insert(decided.items.end(), out.items.begin() + begin,
                             out.items.begin() + end);
      decided.begin.push_back(static_cast<std::uint32_t>(decided.items.size()));
    }
    out.begin = std::move(decided.begin);
    out.items = std::move(decided.items);
  }

  void decide_column(std::int64_t a, std::int64_t b, const SlabCrossings& crossings,
                     std::uint32_t item, std::uint32_t end, std::vector<Crossing>& out) const {
    int winding = 0;
    bool inside = false;
    const std::int64_t top = lattice_.count[2];
    const Range& range = range_[2];
    for (std::int64_t z = 0; z < top;) {
      while (item < end && crossings.items[item].sample <= z)
        winding += crossings.items[item++].sign;
      std::int64_t next =
          item < end ? std::min<std::int64_t>(crossings.items[item].sample, top) : top;
      double w = winding;
      if (z < range[0]) next = std::min(next, range[0]);
      if (z >= range[0] && z < range[1]) {
        next = z + 1;
        w -= winding_of_faces(caps_, sample_at(lattice_, a, b, z));
      }
      if ((std::abs(w) > 0.5) != inside) {
        inside = !inside;
        out.push_back({static_cast<std::int32_t>(z), inside ? 1 : -1});
      }
      z = next;
    }
  }

  ColumnScanner scanner_;
  SampleLattice lattice_;
  int rows_;
  TriangleMesh caps_;             // of all large holes
  std::array<Range, 3> range_{};  // of samples that they may decide
};

class LabelColumns : public Columns {
 public:
  LabelColumns(const LabelImage& image, const std::vector<char>& members,
               const SampleLattice& lattice, int rows)
      : image_(image), members_(members), lattice_(lattice), rows_(rows) {
    find_box();
  }

  bool reaches(std::int64_t slab) const override {
    return range_[0][0] < (slab + 1) * rows_ && range_[0][1] > slab * rows_;
  }

  void scan(std::int64_t slab, SlabCrossings& out) const override {
    out.items.clear();
    out.begin.assign(1, 0);
    const std::int64_t n_columns = lattice_.count[1];
    for (std::int64_t a = slab * rows_; a < (slab + 1) * rows_; ++a)
      for (std::int64_t b = 0; b < n_columns; ++b) {
        if (a >= range_[0][0] && a < range_[0][1] && b >= range_[1][0] && b < range_[1][1])
          scan_column(a, b, out.items);
        out.begin.push_back(static_cast<std::uint32_t>(out.items.size()));
      }
  }

 private:
  // The lattice range of the members' box: its corners in space are those of a parallelepiped.
  void find_box() {
    std::array<std::int64_t, 3> low = image_.size, high{-1, -1, -1};
    std::size_t at = 0;
    for (std::int64_t i = 0; i < image_.size[0]; ++i)
      for (std::int64_t j = 0; j < image_.size[1]; ++j)
        for (std::int64_t k = 0; k < image_.size[2]; ++k, ++at) {
          if (!members_[image_.labels[at]]) continue;
          const std::array<std::int64_t, 3> index{i, j, k};
          for (int axis = 0; axis < 3; ++axis) {
            low[axis] = std::min(low[axis], index[axis]);
            high[axis] = std::max(high[axis], index[axis]);
          }
        }
    if (high[0] < 0) return;
    // Columns of the inverse of the index axes: the step of each index in space.
    const auto& r = image_.axes;
    const double det = dot(r[0], cross(r[1], r[2]));
    const Vec3 step[3] = {(1 / det) * cross(r[1], r[2]), (1 / det) * cross(r[2], r[0]),
                          (1 / det) * cross(r[0], r[1])};
    for (int axis = 0; axis < 3; ++axis) {
      double from = 0, to = 0;
      for (int index = 0; index < 3; ++index) {
        const double p =
            step[index][axis] * (static_cast<double>(low[index]) - 0.5 - image_.offset[index]);
        const double q =
            step[index][axis] * (static_cast<double>(high[index]) + 0.5 - image_.offset[index]);
        from += std::min(p, q);
        to += std::max(p, q);
      }
      range_[axis] = index_range(lattice_, axis, from, to);
    }
  }

  bool holds(const Vec3& p) const {
    std::int64_t index[3];
    for (int axis = 0; axis < 3; ++axis) {
      const double x = std::floor(dot(image_.axes[axis], p) + image_.offset[axis] + 0.5);
      if (!(x >= 0 && x < static_cast<double>(image_.size[axis]))) return false;
      index[axis] = static_cast<std::int64_t>(x);
    }
    return members_[image_.labels[static_cast<std::size_t>(
        (index[0] * image_.size[1] + index[1]) * image_.size[2] + index[2])]];
  }

  void scan_column(std::int64_t a, std::int64_t b, std::vector<Crossing>& out) const {
    bool inside = false;
    for (std::int64_t c = range_[2][0]; c <= range_[2][1] && c < lattice_.count[2]; ++c) {
      const bool here = c < range_[2][1] && holds(sample_at(lattice_, a, b, c));
      if (here == inside) continue;
      inside = here;
      out.push_back({static_cast<std::int32_t>(c), inside ? 1 : -1});
    }
  }

  const LabelImage& image_;
  const std::vector<char>& members_;
  SampleLattice lattice_;
  int rows_;
  std::array<Range, 3> range_{};
};

}  // namespace

double winding_of_faces(const TriangleMesh& mesh, const Vec3& p) {
  double half = 0;  // of the solid angle, by the formula of Van Oosterom & Strackee (1983)
  for (const Face& face : mesh.faces) {
    const Vec3 a = mesh.vertices[face[0]] - p, b = mesh.vertices[face[1]] - p,
               c = mesh.vertices[face[2]] - p;
    const double la = norm(a), lb = norm(b), lc = norm(c);
    half += std::atan2(dot(a, cross(b, c)),
                       la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb);
  }
  return half / (2 * kPi);
}

std::unique_ptr<Columns> make_columns(const Volume& volume, const SampleLattice& lattice,
                                      int rows_per_slab) {
  if (volume.surface)
    return std::make_unique<SurfaceColumns>(*volume.surface, lattice, rows_per_slab);
  return std::make_unique<LabelColumns>(*volume.image, volume.members, lattice, rows_per_slab);
}

}  // namespace tledface
