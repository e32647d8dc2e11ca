// Voxeliser: slabs of voxels along x, each worked by one thread; in a slab, columns of voxels along
// z share the surfaces' crossings, and depths are computed only where the answer depends on them
// (the depth changes by no more than the distance moved). See voxelise.hpp.
#include "voxel/voxelise.hpp"

#include <memory>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "mesh/scanline.hpp"

namespace tledface {
namespace {

// A sample above the outer surface counts as cut by it only where it lies over a face rather than
// beside its rim (cosine between the way to the surface and the face's normal).
constexpr double kOverFace = 0.8;

constexpr std::uint8_t kInside = 1, kBlocked = 2;

double extent_along(const Vec3& normal, const Vec3& size) {
  return std::abs(normal.x) * size.x + std::abs(normal.y) * size.y + std::abs(normal.z) * size.z;
}

struct Depth {
  double depth;  // m, positive inside
  Vec3 gradient;
};

class Voxeliser {
 public:
  explicit Voxeliser(const VoxeliseInput& input)
      : in_(input), outer_(input.outer), n_(input.samples), n_layers_(input.boundaries.size() + 1) {
    const Vec3& h = input.grid.voxel;
    step_ = (1.0 / n_) * h;
    radius_ = 0.5 * norm(h) + 0.5 * norm(step_);
    deepest_ = input.boundaries.empty() ? 0.0 : input.boundaries.back();
    lattice_.first = input.grid.origin + 0.5 * step_;
    lattice_.step = step_;
    for (int a = 0; a < 3; ++a) {
      lattice_.count[a] = input.grid.count[a] * n_;
      allowed_[a] = allowed_range(a);
    }
    skin_ = std::make_unique<ColumnScanner>(*input.skin, lattice_, n_);
    for (const auto* mesh : input.bones) bones_.emplace_back(*mesh, lattice_, n_);
    for (const auto* mesh : input.parts) parts_.emplace_back(*mesh, lattice_, n_);
  }

  std::size_t n_tissues() const { return n_layers_ + parts_.size(); }

  void work_slab(std::int64_t i, Voxels& out) const;

 private:
  struct Scratch {
    SlabCrossings skin;
    std::vector<SlabCrossings> bones, parts;
    std::vector<std::size_t> near_bones, near_parts;
    std::vector<std::uint8_t> state;      // of each sample of a voxel column
    std::vector<std::uint64_t> in_parts;  // bit per muscle surface
    std::vector<double> moments;          // m0 m1 m2 a tissue, of one voxel
  };

  std::array<std::int64_t, 2> allowed_range(int axis) const;
  bool mark_column(std::int64_t i, std::int64_t j, Scratch& scratch, std::int64_t k_range[2]) const;
  template <class Mark>
  void mark_runs(const SlabCrossings& crossings, std::int64_t j, const std::int64_t k_range[2],
                 Mark mark) const;
  Depth depth_at(const Vec3& p, bool inside, const ClosestPoint& hit) const;
  void add_uniform(const Vec3& gradient, std::size_t layer, std::size_t first_sample,
                   Scratch& scratch) const;
  void add_sampled(const Vec3& centre, const Depth& at, std::int32_t guess,
                   std::size_t first_sample, Scratch& scratch) const;
  void add_piece(double begin, double end, double centre_depth, double share, std::uint64_t mask,
                 Scratch& scratch) const;
  std::size_t layer_at(double depth) const {
    std::size_t layer = 0;
    while (layer + 1 < n_layers_ && depth >= in_.boundaries[layer]) ++layer;
    return layer;
  }
  Vec3 offset_of(int a, int b, int c) const {
    const double half = 0.5 * (n_ - 1);
    return {(a - half) * step_.x, (b - half) * step_.y, (c - half) * step_.z};
  }
  void emit(std::int64_t i, std::int64_t j, std::int64_t k, const Vec3& normal, Scratch& scratch,
            Voxels& out) const;

  const VoxeliseInput& in_;
  Bvh outer_;
  int n_;
  std::size_t n_layers_;
  Vec3 step_;
  double radius_;   // no part of a sample's box is farther from the voxel's centre
  double deepest_;  // last finite boundary between layers
  SampleLattice lattice_;
  std::array<std::array<std::int64_t, 2>, 3> allowed_;  // sample indices within the region
  std::unique_ptr<ColumnScanner> skin_;
  std::vector<ColumnScanner> bones_, parts_;
};

std::array<std::int64_t, 2> Voxeliser::allowed_range(int axis) const {
  const double first = lattice_.first[axis], step = lattice_.step[axis];
  const auto count = static_cast<double>(lattice_.count[axis]);
  const double from = std::ceil((in_.region.low[axis] - first) / step);
  const double to = std::floor((in_.region.high[axis] - first) / step) + 1;
  return {static_cast<std::int64_t>(std::clamp(from, 0.0, count)),
          static_cast<std::int64_t>(std::clamp(to, 0.0, count))};
}

// Calls mark(sample index in the voxel column) for each sample inside, voxels k_range only.
template <class Mark>
void Voxeliser::mark_runs(const SlabCrossings& crossings, std::int64_t j,
                          const std::int64_t k_range[2], Mark mark) const {
  const std::int64_t z_begin = k_range[0] * n_, z_end = k_range[1] * n_;
  for (int a = 0; a < n_; ++a)
    for (int b = 0; b < n_; ++b) {
      const std::size_t column = static_cast<std::size_t>(a * lattice_.count[1] + j * n_ + b);
      int winding = 0;
      const std::uint32_t end = crossings.begin[column + 1];
      for (std::uint32_t item = crossings.begin[column]; item < end; ++item) {
        winding += crossings.items[item].sign;
        if (winding == 0) continue;
        const std::int64_t from = std::max<std::int64_t>(crossings.items[item].sample, z_begin);
        const std::int64_t to =
            std::min(item + 1 < end ? crossings.items[item + 1].sample : z_end, z_end);
        for (std::int64_t z = from; z < to; ++z)
          mark(static_cast<std::size_t>(((z / n_ - k_range[0]) * n_ + a) * n_ + b) * n_ + z % n_);
      }
    }
}

// Fills state and in_parts of the voxels (i, j, k_range); false if the skin does not reach them.
bool Voxeliser::mark_column(std::int64_t i, std::int64_t j, Scratch& scratch,
                            std::int64_t k_range[2]) const {
  std::int64_t low = lattice_.count[2], high = 0;
  for (int a = 0; a < n_; ++a) {
    const std::size_t row = static_cast<std::size_t>(a * lattice_.count[1] + j * n_);
    for (std::uint32_t item = scratch.skin.begin[row]; item < scratch.skin.begin[row + n_];
         ++item) {
      low = std::min<std::int64_t>(low, scratch.skin.items[item].sample);
      high = std::max<std::int64_t>(high, scratch.skin.items[item].sample);
    }
  }
  // A column that ends above the lattice has no closing crossing in it.
  for (int a = 0; a < n_ && high < lattice_.count[2]; ++a)
    for (int b = 0; b < n_; ++b) {
      const std::size_t column = static_cast<std::size_t>(a * lattice_.count[1] + j * n_ + b);
      int winding = 0;
      for (std::uint32_t it = scratch.skin.begin[column]; it < scratch.skin.begin[column + 1]; ++it)
        winding += scratch.skin.items[it].sign;
      if (winding != 0) high = lattice_.count[2];
    }
  low = std::max(low, allowed_[2][0]);
  high = std::min(high, allowed_[2][1]);
  if (low >= high) return false;
  k_range[0] = low / n_;
  k_range[1] = (high + n_ - 1) / n_;
  const std::size_t n_samples = static_cast<std::size_t>(k_range[1] - k_range[0]) * n_ * n_ * n_;
  scratch.state.assign(n_samples, 0);
  mark_runs(scratch.skin, j, k_range, [&](std::size_t s) { scratch.state[s] |= kInside; });
  for (const auto bone : scratch.near_bones)
    mark_runs(scratch.bones[bone], j, k_range,
              [&](std::size_t s) { scratch.state[s] |= kBlocked; });
  if (!parts_.empty()) scratch.in_parts.assign(n_samples, 0);
  for (const auto part : scratch.near_parts)
    mark_runs(scratch.parts[part], j, k_range,
              [&](std::size_t s) { scratch.in_parts[s] |= std::uint64_t{1} << part; });
  const auto outside = [&](int axis, std::int64_t index) {
    return index < allowed_[axis][0] || index >= allowed_[axis][1];
  };
  std::size_t s = 0;
  for (std::int64_t k = k_range[0]; k < k_range[1]; ++k)
    for (int a = 0; a < n_; ++a)
      for (int b = 0; b < n_; ++b)
        for (int c = 0; c < n_; ++c, ++s)
          if (outside(0, i * n_ + a) || outside(1, j * n_ + b) || outside(2, k * n_ + c))
            scratch.state[s] |= kBlocked;
  return true;
}

Depth Voxeliser::depth_at(const Vec3& p, bool inside, const ClosestPoint& hit) const {
  const double distance = std::sqrt(hit.distance2);
  Depth result{inside ? distance : -distance, {}};
  // Within rounding of the surface the way to it has no direction: the face has.
  if (distance > 1e-9 * radius_)
    result.gradient = (1 / result.depth) * (p - hit.point);
  else
    result.gradient = -1.0 * outer_.face_normal(hit.face);
  return result;
}

// Adds depths [begin, end], which stand for `share` of the voxel, to the muscles in the mask or to
// the layers.
void Voxeliser::add_piece(double begin, double end, double centre_depth, double share,
                          std::uint64_t mask, Scratch& scratch) const {
  const double width = end - begin;
  begin = std::max(begin, 0.0);
  end = std::min(end, in_.cap);
  if (!(begin < end)) return;
  const auto add = [&](std::size_t tissue, double from, double to, double weight) {
    const double p = from - centre_depth, q = to - centre_depth;
    double* m = &scratch.moments[3 * tissue];
    const double part = weight * (to - from) / width;
    m[0] += part;
    m[1] += part * 0.5 * (p + q);
    m[2] += part * (p * p + p * q + q * q) / 3;
  };
  if (mask != 0) {
    int count = 0;
    for (std::uint64_t rest = mask; rest != 0; rest &= rest - 1) ++count;
    for (std::size_t part = 0; part < parts_.size(); ++part)
      if (mask >> part & 1) add(n_layers_ + part, begin, end, share / count);
    return;
  }
  for (std::size_t layer = layer_at(begin); layer < n_layers_ && begin < end; ++layer) {
    const double to = layer + 1 < n_layers_ ? std::min(end, in_.boundaries[layer]) : end;
    if (to > begin) add(layer, begin, to, share);
    begin = std::max(begin, to);
  }
}

// All samples of the voxel lie in one layer or in muscles, and none is cut: z from the gradient.
void Voxeliser::add_uniform(const Vec3& gradient, std::size_t layer, std::size_t first_sample,
                            Scratch& scratch) const {
  const double width = extent_along(gradient, step_), share = 1.0 / (n_ * n_ * n_);
  std::size_t s = first_sample;
  for (int a = 0; a < n_; ++a)
    for (int b = 0; b < n_; ++b)
      for (int c = 0; c < n_; ++c, ++s) {
        if (scratch.state[s] != kInside) continue;
        const std::uint64_t mask = parts_.empty() ? 0 : scratch.in_parts[s];
        int count = 0;
        for (std::uint64_t rest = mask; rest != 0; rest &= rest - 1) ++count;
        const double z = dot(gradient, offset_of(a, b, c));
        const double second = z * z + width * width / 12;
        const auto add = [&](std::size_t tissue, double weight) {
          double* m = &scratch.moments[3 * tissue];
          m[0] += weight;
          m[1] += weight * z;
          m[2] += weight * second;
        };
        if (count == 0)
          add(layer, share);
        else
          for (std::size_t part = 0; part < parts_.size(); ++part)
            if (mask >> part & 1) add(n_layers_ + part, share / count);
      }
}

void Voxeliser::add_sampled(const Vec3& centre, const Depth& at, std::int32_t guess,
                            std::size_t first_sample, Scratch& scratch) const {
  constexpr double kAnywhere = std::numeric_limits<double>::infinity();
  const double share = 1.0 / (n_ * n_ * n_);
  std::size_t s = first_sample;
  for (int a = 0; a < n_; ++a)
    for (int b = 0; b < n_; ++b)
      for (int c = 0; c < n_; ++c, ++s) {
        if (scratch.state[s] & kBlocked) continue;
        const bool inside = scratch.state[s] & kInside;
        const Vec3 p = centre + offset_of(a, b, c);
        // Outside, only samples whose box the surface cuts matter.
        const double limit2 = inside ? kAnywhere : 0.25 * norm2(step_);
        const ClosestPoint hit = outer_.closest(p, limit2, guess);
        if (hit.face < 0) continue;
        guess = hit.face;
        const Depth here = depth_at(p, inside, hit);
        const double width = extent_along(here.gradient, step_);
        if (!inside && (-here.depth >= 0.5 * width ||
                        -dot(here.gradient, outer_.face_normal(hit.face)) < kOverFace))
          continue;
        add_piece(here.depth - 0.5 * width, here.depth + 0.5 * width, at.depth, share,
                  parts_.empty() ? 0 : scratch.in_parts[s], scratch);
      }
}

void Voxeliser::emit(std::int64_t i, std::int64_t j, std::int64_t k, const Vec3& normal,
                     Scratch& scratch, Voxels& out) const {
  double total = 0;
  for (std::size_t t = 0; t < n_tissues(); ++t) total += scratch.moments[3 * t];
  if (!(total > 0)) return;
  for (const std::int64_t index : {i, j, k}) out.cells.push_back(static_cast<std::int32_t>(index));
  for (std::size_t t = 0; t < n_tissues(); ++t) {
    out.shares.push_back(scratch.moments[3 * t]);
    out.first.push_back(scratch.moments[3 * t + 1]);
    out.second.push_back(scratch.moments[3 * t + 2]);
  }
  for (int a = 0; a < 3; ++a) out.normal.push_back(normal[a]);
}

void Voxeliser::work_slab(std::int64_t i, Voxels& out) const {
  if (!skin_->reaches(i)) return;
  Scratch scratch;
  skin_->scan(i, scratch.skin);
  const auto scan_all = [i](const std::vector<ColumnScanner>& solids,
                            std::vector<SlabCrossings>& crossings, std::vector<std::size_t>& near) {
    crossings.resize(solids.size());
    for (std::size_t s = 0; s < solids.size(); ++s)
      if (solids[s].reaches(i)) {
        solids[s].scan(i, crossings[s]);
        near.push_back(s);
      }
  };
  scan_all(bones_, scratch.bones, scratch.near_bones);
  scan_all(parts_, scratch.parts, scratch.near_parts);
  const std::size_t voxel_samples = static_cast<std::size_t>(n_) * n_ * n_;
  const Vec3& h = in_.grid.voxel;
  std::int64_t k_range[2];
  for (std::int64_t j = 0; j < in_.grid.count[1]; ++j) {
    if (!mark_column(i, j, scratch, k_range)) continue;
    // The last depth computed in this column; others differ from it by at most the way between.
    double last_distance = -1;
    std::int32_t last_face = -1;
    Vec3 last_centre, last_gradient;
    for (std::int64_t k = k_range[0]; k < k_range[1]; ++k) {
      const std::size_t first = static_cast<std::size_t>(k - k_range[0]) * voxel_samples;
      std::size_t n_inside = 0;
      bool one_tissue = true;
      std::uint64_t mask = 0;
      for (std::size_t s = first; s < first + voxel_samples; ++s) {
        if (scratch.state[s] != kInside) continue;
        const std::uint64_t here = parts_.empty() ? 0 : scratch.in_parts[s];
        if (n_inside++ == 0) mask = here;
        one_tissue = one_tissue && here == mask;
      }
      if (n_inside == 0) continue;
      const Vec3 centre = in_.grid.origin + Vec3{(static_cast<double>(i) + 0.5) * h.x,
                                                 (static_cast<double>(j) + 0.5) * h.y,
                                                 (static_cast<double>(k) + 0.5) * h.z};
      if (last_distance >= 0) {
        const double way = norm(centre - last_centre);
        const double least = last_distance - way - radius_;
        if (least > in_.cap) continue;
        if (one_tissue && least > deepest_ && last_distance + way + radius_ < in_.cap) {
          scratch.moments.assign(3 * n_tissues(), 0.0);
          add_uniform(last_gradient, n_layers_ - 1, first, scratch);
          emit(i, j, k, last_gradient, scratch, out);
          continue;
        }
      }
      const ClosestPoint hit =
          outer_.closest(centre, std::numeric_limits<double>::infinity(), last_face);
      last_face = hit.face;
      const double reach = std::sqrt(hit.distance2);
      // Nearer than the radius the centre may lie on either side; farther it is on the samples'.
      const bool inside = reach >= radius_ || outer_.side(centre, hit) <= 0;
      const Depth at = depth_at(centre, inside, hit);
      last_distance = reach;
      last_centre = centre;
      last_gradient = at.gradient;
      const double low = at.depth - radius_, high = at.depth + radius_;
      if (low > in_.cap) continue;
      scratch.moments.assign(3 * n_tissues(), 0.0);
      const std::size_t layer = layer_at(std::max(low, 0.0));
      if (low >= 0 && high <= in_.cap && layer == layer_at(high))
        add_uniform(at.gradient, layer, first, scratch);
      else
        add_sampled(centre, at, hit.face, first, scratch);
      emit(i, j, k, at.gradient, scratch, out);
    }
  }
}

template <class T>
void append(std::vector<T>& to, std::vector<T>& from) {
  to.insert(to.end(), from.begin(), from.end());
  std::vector<T>().swap(from);
}

}  // namespace

Voxels voxelise(const VoxeliseInput& input) {
  if (input.samples < 1 || input.samples > kMaxSamples)
    throw InputError("samples: got " + std::to_string(input.samples) + ", allowed is 1 to " +
                     std::to_string(kMaxSamples) + " a voxel edge");
  if (input.parts.size() > static_cast<std::size_t>(kMaxParts))
    throw InputError("muscles: got " + std::to_string(input.parts.size()) +
                     " surfaces, allowed are up to " + std::to_string(kMaxParts) +
                     "; join surfaces of one muscle into one file");
  if (input.outer.faces.empty())
    throw InputError(
        "outer: no skin face lies in its boxes, so no depth can be measured; a box must "
        "hold the middles of the outer faces");
  const Voxeliser worker(input);
  std::vector<Voxels> slabs(static_cast<std::size_t>(input.grid.count[0]));
  parallel_for(slabs.size(),
               [&](std::size_t i) { worker.work_slab(static_cast<std::int64_t>(i), slabs[i]); });
  Voxels result;
  result.n_tissues = worker.n_tissues();
  for (Voxels& slab : slabs) {
    append(result.cells, slab.cells);
    append(result.shares, slab.shares);
    append(result.first, slab.first);
    append(result.second, slab.second);
    append(result.normal, slab.normal);
  }
  return result;
}

}  // namespace tledface
