// Which volume has a sample where several overlap: the one of the lowest rank, in equal shares to
// muscle surfaces of one rank.
#pragma once
#include <cstdint>
#include <limits>
#include <vector>

namespace tledface {

// State bits of a sample.
constexpr std::uint8_t kInside = 1;  // of the skin
constexpr std::uint8_t kBone = 2;
constexpr std::uint8_t kCut = 4;  // beyond the region

class Owners {
 public:
  Owners(bool any_bone, int bone_rank, std::vector<int> part_ranks, std::vector<int> layer_ranks)
      : bone_rank_(bone_rank),
        part_ranks_(std::move(part_ranks)),
        layer_ranks_(std::move(layer_ranks)) {
    int last = any_bone ? bone_rank : std::numeric_limits<int>::min();
    for (const int rank : part_ranks_) {
      last = rank > last ? rank : last;
      one_part_rank_ = one_part_rank_ && rank == part_ranks_[0];
    }
    for (const int rank : layer_ranks_) {
      layers_last_ = layers_last_ && rank > last;
      layers_over_bone_ = layers_over_bone_ || (any_bone && rank < bone_rank);
    }
  }

  bool layers_last() const { return layers_last_; }  // no layer goes before bone or muscle
  bool layers_over_bone() const { return layers_over_bone_; }

  // Leaves a sample to the bone or to the muscle surfaces of the lowest rank.
  void resolve(std::uint8_t& state, std::uint64_t& parts) const {
    if (parts == 0) return;
    if (!one_part_rank_) {
      int best = std::numeric_limits<int>::max();
      for_bits(parts, [&](std::size_t part) {
        best = part_ranks_[part] < best ? part_ranks_[part] : best;
      });
      std::uint64_t kept = 0;
      for_bits(parts, [&](std::size_t part) {
        if (part_ranks_[part] == best) kept |= std::uint64_t{1} << part;
      });
      parts = kept;
    }
    if (!(state & kBone)) return;
    if (bone_rank_ <= rank_of(0, parts))
      parts = 0;
    else
      state &= static_cast<std::uint8_t>(~kBone);
  }

  // Calls give(tissue, part) for the owners of a resolved sample whose depth lies in the layer;
  // tissues are the layers, then the parts. Bone is no tissue.
  template <class Give>
  void give_to_owner(std::size_t layer, std::uint8_t state, std::uint64_t parts, Give give) const {
    const bool taken = parts != 0 || (state & kBone);
    if (!taken || (!layers_last_ && layer_ranks_[layer] < rank_of(state, parts))) {
      give(layer, 1.0);
    } else if (parts != 0) {
      int count = 0;
      for (std::uint64_t rest = parts; rest != 0; rest &= rest - 1) ++count;
      for_bits(parts, [&](std::size_t part) { give(layer_ranks_.size() + part, 1.0 / count); });
    }
  }

 private:
  template <class Visit>
  static void for_bits(std::uint64_t mask, Visit visit) {
    for (std::size_t bit = 0; mask != 0; ++bit, mask >>= 1)
      if (mask & 1) visit(bit);
  }

  int rank_of(std::uint8_t state, std::uint64_t parts) const {
    if (state & kBone) return bone_rank_;
    std::size_t part = 0;
    while (!(parts >> part & 1)) ++part;
    return part_ranks_[part];
  }

  int bone_rank_;
  std::vector<int> part_ranks_, layer_ranks_;
  bool one_part_rank_ = true, layers_last_ = true, layers_over_bone_ = false;
};

}  // namespace tledface
