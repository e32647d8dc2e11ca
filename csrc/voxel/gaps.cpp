// Gaps by closest points, in the few voxels that two surfaces come near. See gaps.hpp.
#include "voxel/gaps.hpp"

#include "core/threads.hpp"
#include "mesh/bvh.hpp"

namespace tledface {
namespace {

constexpr int kSamples = 2;
constexpr double kOpposed = -0.7;  // cosine between the ways to the two surfaces
constexpr std::size_t kChunk = 512;

}  // namespace

std::vector<double> gap_volumes(const std::vector<const Surface*>& surfaces, const Vec3& origin,
                                const Vec3& voxel, const std::vector<std::int32_t>& cells,
                                double width) {
  const std::size_t n = surfaces.size(), n_cells = cells.size() / 3;
  std::vector<Bvh> trees;
  trees.reserve(n);
  for (const Surface* surface : surfaces) trees.emplace_back(surface->mesh);
  const double reach = width + 0.5 * norm(voxel);
  const double share = voxel.x * voxel.y * voxel.z / (kSamples * kSamples * kSamples);
  const std::size_t n_chunks = (n_cells + kChunk - 1) / kChunk;
  std::vector<std::vector<std::uint32_t>> counts(n_chunks);
  parallel_for(n_chunks, [&](std::size_t chunk) {
    counts[chunk].assign(n * n, 0);
    struct Near {
      std::size_t surface;
      std::int32_t face;
      double distance;
      Vec3 way;  // unit, from the surface
    };
    std::vector<Near> near, here;
    const std::size_t end = std::min((chunk + 1) * kChunk, n_cells);
    for (std::size_t e = chunk * kChunk; e < end; ++e) {
      const Vec3 low = origin + Vec3{cells[3 * e] * voxel.x, cells[3 * e + 1] * voxel.y,
                                     cells[3 * e + 2] * voxel.z};
      near.clear();
      for (std::size_t s = 0; s < n; ++s) {
        const ClosestPoint hit = trees[s].closest(low + 0.5 * voxel, reach * reach);
        if (hit.face >= 0) near.push_back({s, hit.face, 0, {}});
      }
      if (near.size() < 2) continue;
      for (int sample = 0; sample < kSamples * kSamples * kSamples; ++sample) {
        const int a = sample / (kSamples * kSamples), b = sample / kSamples % kSamples,
                  c = sample % kSamples;
        const Vec3 p = low + Vec3{(a + 0.5) / kSamples * voxel.x, (b + 0.5) / kSamples * voxel.y,
                                  (c + 0.5) / kSamples * voxel.z};
        here.clear();
        bool within = false;
        for (const Near& candidate : near) {
          const Bvh& tree = trees[candidate.surface];
          const ClosestPoint hit = tree.closest(p, reach * reach, candidate.face);
          const int outside = candidate.surface + 1 == n ? -1 : 1;
          within = within || (hit.face >= 0 && tree.side(p, hit) != outside);
          if (hit.face >= 0 && hit.distance2 <= width * width)
            here.push_back(
                {candidate.surface, hit.face, std::sqrt(hit.distance2), unit(p - hit.point)});
        }
        if (within) continue;
        for (std::size_t i = 0; i < here.size(); ++i)
          for (std::size_t j = i + 1; j < here.size(); ++j)
            if (here[i].distance + here[j].distance <= width &&
                dot(here[i].way, here[j].way) < kOpposed)
              ++counts[chunk][here[i].surface * n + here[j].surface];
      }
    }
  });
  std::vector<double> volumes(n * n, 0.0);
  for (const auto& chunk : counts)
    for (std::size_t i = 0; i < volumes.size(); ++i) volumes[i] += share * chunk[i];
  return volumes;
}

}  // namespace tledface
