// Depth below the outer surface, the layers' ends there, and how deep tissue is kept.
#pragma once
#include <limits>
#include <vector>

#include "mesh/bvh.hpp"

namespace tledface {

// Tissue in the box is kept down to this depth; of several boxes the last one that holds a place
// decides.
struct DepthBox {
  Bounds box;
  double cap;  // m
};

struct Depth {
  double depth;  // m, positive inside
  Vec3 gradient;
};

class DepthField {
 public:
  // boundaries: m, depth of each layer's end but the last's, not falling from layer to layer: one
  // value, or one for each vertex of `outer`, linear on its faces.
  DepthField(TriangleMesh outer, std::vector<std::vector<double>> boundaries, double cap,
             std::vector<DepthBox> local_caps);

  const Bvh& outer() const { return outer_; }
  std::size_t n_layers() const { return boundaries_.size() + 1; }

  // Depth of p from its closest point; a distance below `rounding` has the face's direction.
  Depth at(const Vec3& p, bool inside, const ClosestPoint& hit, double rounding) const;

  // The ends of the layers but the last below a place of the outer surface.
  void find_ends(const ClosestPoint& hit, std::vector<double>& ends) const;

  // Whether all depths from low to high lie in one layer wherever they are measured.
  bool one_layer(double low, double high, std::size_t& layer) const;

  // No layer but the last is deeper than this.
  double last_layer_from() const { return deepest_.empty() ? 0.0 : deepest_.back(); }

  double cap_at(const Vec3& p) const;

  // Least and greatest cap in a box, or a wider range.
  std::array<double, 2> cap_range(const Bounds& box) const;

 private:
  Bvh outer_;
  std::vector<std::vector<double>> boundaries_;
  std::vector<double> shallowest_, deepest_;  // of each boundary
  double cap_;
  std::vector<DepthBox> local_caps_;
};

}  // namespace tledface
