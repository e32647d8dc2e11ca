// Closed volumes -> voxels with tissue fractions and depth moments, by n^3 samples a voxel.
//
// Sample (a, b, c) of a voxel sits at its low corner + ((a, b, c) + 1/2) h / n, so a surface on
// voxel faces never meets a sample. A sample may be tissue inside the skin (columns.hpp), within
// the region, and no deeper than the cap of its place. Of the bones and muscle surfaces that it
// lies in and the layer at its depth d, the distance from the outer surface, it belongs to the one
// of the lowest rank, in equal shares to muscle surfaces of one rank; in bone there is no tissue. A
// sample stands for the depths d - w/2 ... d + w/2 with w = sum_a |n_a| h_a / n (the extent of its
// box along the gradient n of the depth), clipped against [0, cap] and the layers' intervals, so a
// flat layer along the grid comes out exact however thin, and on other slopes without bias.
//
// Per voxel and tissue, with z = depth minus the depth of the voxel's centre, the moments m0, m1,
// m2 = the tissue's share of the voxel times 1, mean z, mean z^2, from which the section modulus of
// a layered voxel follows (that does not depend on where z is zero).
#pragma once
#include <cstdint>
#include <limits>
#include <vector>

#include "voxel/columns.hpp"
#include "voxel/depth_field.hpp"
#include "voxel/tally.hpp"

namespace tledface {

struct VoxelGrid {
  Vec3 origin;  // m, low corner of cell (0, 0, 0)
  Vec3 voxel;   // m
  std::array<std::int64_t, 3> count;
};

struct VoxeliseInput {
  VoxelGrid grid;
  int samples = 4;  // n of n^3
  Volume skin;
  TriangleMesh outer;  // faces of the skin that depth is measured from
  std::vector<Volume> bones;
  std::vector<Volume> parts;                             // muscle surfaces, or tissues of an image
  std::vector<std::vector<double>> boundaries;           // see DepthField
  double cap = std::numeric_limits<double>::infinity();  // m, tissue deeper than this is left out
  std::vector<DepthBox> local_caps;
  Bounds region;      // m, tissue outside it is left out
  int bone_rank = 0;  // where volumes overlap, the lowest rank has the place
  std::vector<int> part_ranks, layer_ranks;
};

// Every voxel with any tissue, in lexicographic order of (i, j, k); tissues are the layers, then
// the muscle surfaces.
struct Voxels {
  std::size_t n_tissues = 0;
  std::vector<std::int32_t> cells;    // 3 a voxel
  std::vector<double> shares;         // n_tissues a voxel, sum at most 1: m0
  std::vector<double> first, second;  // n_tissues a voxel: m1 (m), m2 (m^2)
  std::vector<double> normal;         // 3 a voxel, unit gradient of the depth
  std::vector<double> inner;          // share of a voxel in bone, too deep or beyond the region
  double too_deep = 0;                // voxel volumes inside the skin, out of bone, beyond the cap
  Tally tally;                        // samples; volumes are the bones, the parts, the skin
};

constexpr int kMaxSamples = 16;
constexpr int kMaxParts = 64;

Voxels voxelise(const VoxeliseInput& input);

}  // namespace tledface
