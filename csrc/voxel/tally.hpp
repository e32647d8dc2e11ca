// How volumes lie to each other, counted in lattice samples: overlaps, parts outside the skin,
// places where a surface covers itself.
#pragma once
#include <cstdint>
#include <vector>

#include "mesh/scanline.hpp"

namespace tledface {

// Counts of samples within the region; volumes are the bones, the muscle surfaces, then the skin.
struct Tally {
  explicit Tally(std::size_t n_volumes = 0)
      : n(n_volumes), inside(n), covered_twice(n), reversed(n), both(n * n) {}

  std::size_t n;
  std::vector<std::uint64_t> inside;
  std::vector<std::uint64_t> covered_twice;  // winding number 2 or more: parts that overlap
  std::vector<std::uint64_t> reversed;       // winding number below 0: inside-out parts
  std::vector<std::uint64_t> both;           // of volumes p < q at p * n + q

  Tally& operator+=(const Tally& other);
};

// Counts the samples [z_begin, z_end) of one column; volumes that are null do not reach it.
void tally_column(const std::vector<const SlabCrossings*>& volumes, std::size_t column,
                  std::int64_t z_begin, std::int64_t z_end, Tally& tally);

}  // namespace tledface
