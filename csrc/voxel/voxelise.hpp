// Closed surfaces -> voxels with tissue fractions and depth moments, by n^3 samples a voxel.
//
// Sample (a, b, c) of a voxel sits at its low corner + ((a, b, c) + 1/2) h / n, so a surface on
// voxel faces never meets a sample. A sample is tissue inside the skin and outside every bone
// (winding numbers, scanline.hpp), within the region, and no deeper than the cap; it belongs to the
// muscles it lies in (in equal shares), else to the layer at its depth d, the distance from the
// outer surface. A sample stands for the depths d - w/2 ... d + w/2 with w = sum_a |n_a| h_a / n
// (the extent of its box along the gradient n of the depth), clipped against [0, cap] and the
// layers' intervals, so a flat layer along the grid comes out exact however thin, and on other
// slopes without bias.
//
// Per voxel and tissue, with z = depth minus the depth of the voxel's centre, the moments m0, m1,
// m2 = the tissue's share of the voxel times 1, mean z, mean z^2, from which the section modulus of
// a layered voxel follows (that does not depend on where z is zero).
#pragma once
#include <cstdint>
#include <limits>
#include <string>
#include <vector>

#include "mesh/bvh.hpp"
#include "mesh/surface.hpp"

namespace tledface {

struct VoxelGrid {
  Vec3 origin;  // m, low corner of cell (0, 0, 0)
  Vec3 voxel;   // m
  std::array<std::int64_t, 3> count;
};

struct VoxeliseInput {
  VoxelGrid grid;
  int samples = 4;  // n of n^3
  const TriangleMesh* skin = nullptr;
  TriangleMesh outer;  // faces of the skin that depth is measured from
  std::vector<const TriangleMesh*> bones;
  std::vector<const TriangleMesh*> parts;  // muscle surfaces
  std::vector<double> boundaries;          // m, depth of each layer's end but the last's, rising
  double cap = std::numeric_limits<double>::infinity();  // m, tissue deeper than this is left out
  Bounds region;                                         // m, tissue outside it is left out
};

// Every voxel with any tissue, in lexicographic order of (i, j, k); tissues are the layers, then
// the muscle surfaces.
struct Voxels {
  std::size_t n_tissues = 0;
  std::vector<std::int32_t> cells;    // 3 a voxel
  std::vector<double> shares;         // n_tissues a voxel, sum at most 1: m0
  std::vector<double> first, second;  // n_tissues a voxel: m1 (m), m2 (m^2)
  std::vector<double> normal;         // 3 a voxel, unit gradient of the depth
};

constexpr int kMaxSamples = 16;
constexpr int kMaxParts = 64;

Voxels voxelise(const VoxeliseInput& input);

}  // namespace tledface
