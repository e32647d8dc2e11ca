// Run lists of a column intersected pair by pair. See tally.hpp.
#include "voxel/tally.hpp"

#include <algorithm>

namespace tledface {
namespace {

void add(std::vector<std::uint64_t>& to, const std::vector<std::uint64_t>& from) {
  for (std::size_t i = 0; i < to.size(); ++i) to[i] += from[i];
}

}  // namespace

Tally& Tally::operator+=(const Tally& other) {
  add(inside, other.inside);
  add(covered_twice, other.covered_twice);
  add(reversed, other.reversed);
  add(both, other.both);
  return *this;
}

void tally_column(const std::vector<const SlabCrossings*>& volumes, std::size_t column,
                  std::int64_t z_begin, std::int64_t z_end, Tally& tally) {
  struct Run {
    std::size_t volume;
    std::int64_t from, to;
  };
  thread_local std::vector<Run> runs;
  runs.clear();
  for (std::size_t v = 0; v < volumes.size(); ++v) {
    if (!volumes[v]) continue;
    const SlabCrossings& crossings = *volumes[v];
    int winding = 0;
    const std::uint32_t end = crossings.begin[column + 1];
    for (std::uint32_t item = crossings.begin[column]; item < end; ++item) {
      winding += crossings.items[item].sign;
      const std::int64_t from = std::max<std::int64_t>(crossings.items[item].sample, z_begin);
      const std::int64_t to =
          std::min<std::int64_t>(item + 1 < end ? crossings.items[item + 1].sample : z_end, z_end);
      if (winding == 0 || from >= to) continue;
      const auto length = static_cast<std::uint64_t>(to - from);
      tally.inside[v] += length;
      if (winding > 1) tally.covered_twice[v] += length;
      if (winding < 0) tally.reversed[v] += length;
      runs.push_back({v, from, to});
    }
  }
  for (std::size_t p = 0; p < runs.size(); ++p)
    for (std::size_t q = p + 1; q < runs.size(); ++q) {
      const std::int64_t length =
          std::min(runs[p].to, runs[q].to) - std::max(runs[p].from, runs[q].from);
      if (runs[p].volume != runs[q].volume && length > 0)
        tally.both[runs[p].volume * tally.n + runs[q].volume] += static_cast<std::uint64_t>(length);
    }
}

}  // namespace tledface
