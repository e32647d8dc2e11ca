// Voxeliser: slabs of voxels along x, each worked by one thread; in a slab, columns of voxels along
// z share the volumes' crossings, and depths are computed only where the answer depends on them
// (the depth changes by no more than the distance moved). See voxelise.hpp.
#include "voxel/voxelise.hpp"

#include <algorithm>
#include <memory>
#include <string>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "voxel/owners.hpp"

namespace tledface {
namespace {

// A sample above the outer surface counts as cut by it only where it lies over a face rather than
// beside its rim (cosine between the way to the surface and the face's normal).
constexpr double kOverFace = 0.8;

double extent_along(const Vec3& normal, const Vec3& size) {
  return std::abs(normal.x) * size.x + std::abs(normal.y) * size.y + std::abs(normal.z) * size.z;
}

class Voxeliser {
 public:
  explicit Voxeliser(const VoxeliseInput& input)
      : in_(input),
        depths_(input.outer, input.boundaries, input.cap, input.local_caps),
        owners_(!input.bones.empty(), input.bone_rank, input.part_ranks, input.layer_ranks),
        n_(input.samples),
        n_layers_(input.boundaries.size() + 1),
        n_bones_(input.bones.size()),
        n_parts_(input.parts.size()) {
    const Vec3& h = input.grid.voxel;
    step_ = (1.0 / n_) * h;
    radius_ = 0.5 * norm(h) + 0.5 * norm(step_);
    lattice_.first = input.grid.origin + 0.5 * step_;
    lattice_.step = step_;
    for (int a = 0; a < 3; ++a) {
      lattice_.count[a] = input.grid.count[a] * n_;
      allowed_[a] = allowed_range(a);
    }
    for (const Volume& bone : input.bones) volumes_.push_back(make_columns(bone, lattice_, n_));
    for (const Volume& part : input.parts) volumes_.push_back(make_columns(part, lattice_, n_));
    volumes_.push_back(make_columns(input.skin, lattice_, n_));
  }

  std::size_t n_tissues() const { return n_layers_ + n_parts_; }
  std::size_t n_volumes() const { return volumes_.size(); }

  void work_slab(std::int64_t i, Voxels& out) const;

 private:
  struct Scratch {
    std::vector<SlabCrossings> crossings;    // bones, parts, skin
    std::vector<const SlabCrossings*> near;  // null where a volume does not reach the slab
    std::vector<std::uint8_t> state;         // of each sample of a voxel column
    std::vector<std::uint64_t> in_parts;     // bit per muscle surface that has the sample
    std::vector<double> moments;             // m0 m1 m2 a tissue, of one voxel
    std::vector<double> ends;                // of the layers but the last, where a sample lies
    double too_deep = 0;                     // of one voxel
  };

  std::array<std::int64_t, 2> allowed_range(int axis) const;
  void count_slab(std::int64_t i, const Scratch& scratch, Tally& tally) const;
  bool mark_column(std::int64_t i, std::int64_t j, Scratch& scratch, std::int64_t k_range[2]) const;
  template <class Mark>
  void mark_runs(const SlabCrossings& crossings, std::int64_t j, const std::int64_t k_range[2],
                 Mark mark) const;
  Depth depth_at(const Vec3& p, bool inside, const ClosestPoint& hit) const {
    return depths_.at(p, inside, hit, 1e-9 * radius_);
  }
  void add_uniform(const Vec3& gradient, std::size_t layer, std::size_t first_sample,
                   Scratch& scratch) const;
  void add_sampled(const Vec3& centre, const Depth& at, std::int32_t guess,
                   std::size_t first_sample, Scratch& scratch) const;
  void add_piece(double begin, double end, double cap, double centre_depth, double share,
                 std::size_t sample, Scratch& scratch) const;
  Vec3 offset_of(int a, int b, int c) const {
    const double half = 0.5 * (n_ - 1);
    return {(a - half) * step_.x, (b - half) * step_.y, (c - half) * step_.z};
  }
  void emit(std::int64_t i, std::int64_t j, std::int64_t k, const Vec3& normal,
            std::size_t first_sample, Scratch& scratch, Voxels& out) const;

  const VoxeliseInput& in_;
  DepthField depths_;
  Owners owners_;
  int n_;
  std::size_t n_layers_, n_bones_, n_parts_;
  Vec3 step_;
  double radius_;  // no part of a sample's box is farther from the voxel's centre
  SampleLattice lattice_;
  std::array<std::array<std::int64_t, 2>, 3> allowed_;  // sample indices within the region
  std::vector<std::unique_ptr<Columns>> volumes_;       // bones, parts, skin
};

std::array<std::int64_t, 2> Voxeliser::allowed_range(int axis) const {
  const double first = lattice_.first[axis], step = lattice_.step[axis];
  const auto count = static_cast<double>(lattice_.count[axis]);
  const double from = std::ceil((in_.region.low[axis] - first) / step);
  const double to = std::floor((in_.region.high[axis] - first) / step) + 1;
  return {static_cast<std::int64_t>(std::clamp(from, 0.0, count)),
          static_cast<std::int64_t>(std::clamp(to, 0.0, count))};
}

void Voxeliser::count_slab(std::int64_t i, const Scratch& scratch, Tally& tally) const {
  for (std::int64_t a = std::max(i * n_, allowed_[0][0]);
       a < std::min((i + 1) * n_, allowed_[0][1]); ++a)
    for (std::int64_t b = allowed_[1][0]; b < allowed_[1][1]; ++b)
      tally_column(scratch.near, static_cast<std::size_t>((a - i * n_) * lattice_.count[1] + b),
                   allowed_[2][0], allowed_[2][1], tally);
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
  const SlabCrossings& skin = *scratch.near.back();
  std::int64_t low = lattice_.count[2], high = 0;
  for (int a = 0; a < n_; ++a) {
    const std::size_t row = static_cast<std::size_t>(a * lattice_.count[1] + j * n_);
    for (std::uint32_t item = skin.begin[row]; item < skin.begin[row + n_]; ++item) {
      low = std::min<std::int64_t>(low, skin.items[item].sample);
      high = std::max<std::int64_t>(high, skin.items[item].sample);
    }
  }
  // A column that ends above the lattice has no closing crossing in it.
  for (int a = 0; a < n_ && high < lattice_.count[2]; ++a)
    for (int b = 0; b < n_; ++b) {
      const std::size_t column = static_cast<std::size_t>(a * lattice_.count[1] + j * n_ + b);
      int winding = 0;
      for (std::uint32_t it = skin.begin[column]; it < skin.begin[column + 1]; ++it)
        winding += skin.items[it].sign;
      if (winding != 0) high = lattice_.count[2];
    }
  low = std::max(low, allowed_[2][0]);
  high = std::min(high, allowed_[2][1]);
  if (low >= high) return false;
  k_range[0] = low / n_;
  k_range[1] = (high + n_ - 1) / n_;
  const std::size_t n_samples = static_cast<std::size_t>(k_range[1] - k_range[0]) * n_ * n_ * n_;
  scratch.state.assign(n_samples, 0);
  mark_runs(skin, j, k_range, [&](std::size_t s) { scratch.state[s] |= kInside; });
  for (std::size_t bone = 0; bone < n_bones_; ++bone)
    if (scratch.near[bone])
      mark_runs(*scratch.near[bone], j, k_range, [&](std::size_t s) { scratch.state[s] |= kBone; });
  scratch.in_parts.assign(n_samples, 0);
  bool any_part = false;
  for (std::size_t part = 0; part < n_parts_; ++part) {
    if (!scratch.near[n_bones_ + part]) continue;
    any_part = true;
    mark_runs(*scratch.near[n_bones_ + part], j, k_range,
              [&](std::size_t s) { scratch.in_parts[s] |= std::uint64_t{1} << part; });
  }
  if (any_part)
    for (std::size_t s = 0; s < n_samples; ++s)
      owners_.resolve(scratch.state[s], scratch.in_parts[s]);
  const auto outside = [&](int axis, std::int64_t index) {
    return index < allowed_[axis][0] || index >= allowed_[axis][1];
  };
  std::size_t s = 0;
  for (std::int64_t k = k_range[0]; k < k_range[1]; ++k)
    for (int a = 0; a < n_; ++a)
      for (int b = 0; b < n_; ++b)
        for (int c = 0; c < n_; ++c, ++s)
          if (outside(0, i * n_ + a) || outside(1, j * n_ + b) || outside(2, k * n_ + c))
            scratch.state[s] |= kCut;
  return true;
}

// Adds depths [begin, end], which stand for `share` of the voxel.
void Voxeliser::add_piece(double begin, double end, double cap, double centre_depth, double share,
                          std::size_t sample, Scratch& scratch) const {
  const double width = end - begin;
  begin = std::max(begin, 0.0);
  if (end > cap && !(scratch.state[sample] & kBone))
    scratch.too_deep += share * (end - std::max(begin, cap)) / width;
  end = std::min(end, cap);
  if (!(begin < end)) return;
  const auto add = [&](std::size_t layer, double from, double to) {
    const double p = from - centre_depth, q = to - centre_depth;
    owners_.give_to_owner(layer, scratch.state[sample], scratch.in_parts[sample],
                          [&](std::size_t tissue, double part_of) {
                            double* m = &scratch.moments[3 * tissue];
                            const double part = part_of * share * (to - from) / width;
                            m[0] += part;
                            m[1] += part * 0.5 * (p + q);
                            m[2] += part * (p * p + p * q + q * q) / 3;
                          });
  };
  // Where no layer goes before muscles, those need no cut at the layers' ends.
  if (owners_.layers_last() && scratch.in_parts[sample] != 0) {
    add(0, begin, end);
    return;
  }
  for (std::size_t layer = 0; layer < n_layers_ && begin < end; ++layer) {
    const double to = layer + 1 < n_layers_ ? std::min(end, scratch.ends[layer]) : end;
    if (to > begin) add(layer, begin, to);
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
        if (!(scratch.state[s] & kInside) || (scratch.state[s] & kCut)) continue;
        const double z = dot(gradient, offset_of(a, b, c));
        const double second = z * z + width * width / 12;
        owners_.give_to_owner(layer, scratch.state[s], scratch.in_parts[s],
                              [&](std::size_t tissue, double part_of) {
                                double* m = &scratch.moments[3 * tissue];
                                const double weight = share * part_of;
                                m[0] += weight;
                                m[1] += weight * z;
                                m[2] += weight * second;
                              });
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
        if (scratch.state[s] & kCut) continue;
        if ((scratch.state[s] & kBone) && !owners_.layers_over_bone()) continue;
        const bool inside = scratch.state[s] & kInside;
        const Vec3 p = centre + offset_of(a, b, c);
        // Outside, only samples whose box the surface cuts matter.
        const double limit2 = inside ? kAnywhere : 0.25 * norm2(step_);
        const ClosestPoint hit = depths_.outer().closest(p, limit2, guess);
        if (hit.face < 0) continue;
        guess = hit.face;
        const Depth here = depth_at(p, inside, hit);
        const double width = extent_along(here.gradient, step_);
        if (!inside && (-here.depth >= 0.5 * width ||
                        -dot(here.gradient, depths_.outer().face_normal(hit.face)) < kOverFace))
          continue;
        depths_.find_ends(hit, scratch.ends);
        add_piece(here.depth - 0.5 * width, here.depth + 0.5 * width, depths_.cap_at(p), at.depth,
                  share, s, scratch);
      }
}

void Voxeliser::emit(std::int64_t i, std::int64_t j, std::int64_t k, const Vec3& normal,
                     std::size_t first_sample, Scratch& scratch, Voxels& out) const {
  out.too_deep += scratch.too_deep;
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
  const std::size_t voxel_samples = static_cast<std::size_t>(n_) * n_ * n_;
  std::size_t n_inner = 0;
  for (std::size_t s = first_sample; s < first_sample + voxel_samples; ++s)
    n_inner += (scratch.state[s] & (kBone | kCut)) != 0;
  const double inner =
      static_cast<double>(n_inner) / static_cast<double>(voxel_samples) + scratch.too_deep;
  out.inner.push_back(std::clamp(inner, 0.0, std::max(1 - total, 0.0)));
}

void Voxeliser::work_slab(std::int64_t i, Voxels& out) const {
  out.tally = Tally(volumes_.size());
  Scratch scratch;
  scratch.crossings.resize(volumes_.size());
  scratch.near.assign(volumes_.size(), nullptr);
  for (std::size_t v = 0; v < volumes_.size(); ++v) {
    if (!volumes_[v]->reaches(i)) continue;
    volumes_[v]->scan(i, scratch.crossings[v]);
    scratch.near[v] = &scratch.crossings[v];
  }
  count_slab(i, scratch, out.tally);
  if (!scratch.near.back()) return;
  const std::size_t voxel_samples = static_cast<std::size_t>(n_) * n_ * n_;
  const Vec3& h = in_.grid.voxel;
  const std::uint8_t excluded = owners_.layers_over_bone() ? kCut : kCut | kBone;
  std::int64_t k_range[2];
  for (std::int64_t j = 0; j < in_.grid.count[1]; ++j) {
    if (!mark_column(i, j, scratch, k_range)) continue;
    // The last depth computed in this column; others differ from it by at most the way between.
    double last_distance = -1;
    std::int32_t last_face = -1;
    Vec3 last_centre, last_gradient;
    for (std::int64_t k = k_range[0]; k < k_range[1]; ++k) {
      const std::size_t first = static_cast<std::size_t>(k - k_range[0]) * voxel_samples;
      std::size_t n_inside = 0, n_free = 0;
      bool one_owner = true;
      std::uint64_t owner = 0;
      for (std::size_t s = first; s < first + voxel_samples; ++s) {
        if (!(scratch.state[s] & kInside) || (scratch.state[s] & excluded)) continue;
        const std::uint64_t here = scratch.in_parts[s];
        if (n_inside++ == 0) owner = here;
        one_owner = one_owner && here == owner && !(scratch.state[s] & kBone);
        n_free += !(scratch.state[s] & kBone);
      }
      if (n_inside == 0) continue;
      const auto all_too_deep = [&] {
        out.too_deep += static_cast<double>(n_free) / static_cast<double>(voxel_samples);
      };
      const Vec3 centre = in_.grid.origin + Vec3{(static_cast<double>(i) + 0.5) * h.x,
                                                 (static_cast<double>(j) + 0.5) * h.y,
                                                 (static_cast<double>(k) + 0.5) * h.z};
      const auto [cap_low, cap_high] = depths_.cap_range({centre - 0.5 * h, centre + 0.5 * h});
      scratch.too_deep = 0;
      std::size_t layer;
      if (last_distance >= 0) {
        const double way = norm(centre - last_centre);
        const double least = last_distance - way - radius_;
        if (least > cap_high) {
          all_too_deep();
          continue;
        }
        if (one_owner && least > depths_.last_layer_from() &&
            last_distance + way + radius_ < cap_low) {
          scratch.moments.assign(3 * n_tissues(), 0.0);
          add_uniform(last_gradient, n_layers_ - 1, first, scratch);
          emit(i, j, k, last_gradient, first, scratch, out);
          continue;
        }
      }
      const ClosestPoint hit =
          depths_.outer().closest(centre, std::numeric_limits<double>::infinity(), last_face);
      last_face = hit.face;
      const double reach = std::sqrt(hit.distance2);
      // Nearer than the radius the centre may lie on either side; farther it is on the samples'.
      const bool inside = reach >= radius_ || depths_.outer().side(centre, hit) <= 0;
      const Depth at = depth_at(centre, inside, hit);
      last_distance = reach;
      last_centre = centre;
      last_gradient = at.gradient;
      const double low = at.depth - radius_, high = at.depth + radius_;
      if (low > cap_high) {
        all_too_deep();
        continue;
      }
      scratch.moments.assign(3 * n_tissues(), 0.0);
      if (low >= 0 && high <= cap_low && depths_.one_layer(low, high, layer))
        add_uniform(at.gradient, layer, first, scratch);
      else
        add_sampled(centre, at, hit.face, first, scratch);
      emit(i, j, k, at.gradient, first, scratch, out);
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
  result.tally = Tally(worker.n_volumes());
  for (Voxels& slab : slabs) {
    append(result.cells, slab.cells);
    append(result.shares, slab.shares);
    append(result.first, slab.first);
    append(result.second, slab.second);
    append(result.normal, slab.normal);
    append(result.inner, slab.inner);
    result.too_deep += slab.too_deep;
    result.tally += slab.tally;
  }
  return result;
}

}  // namespace tledface
