// Closest points on a triangle surface through a tree of boxes.
//
// The side of a point is the sign against the angle-weighted pseudonormal of the feature (face,
// edge or vertex) on which the closest point lies (Baerentzen & Aanaes 2005), which is right for
// any closed surface without self-intersection.
#pragma once
#include <cstdint>
#include <limits>
#include <vector>

#include "mesh/triangle_mesh.hpp"

namespace tledface {

struct ClosestPoint {
  double distance2 = std::numeric_limits<double>::infinity();  // m^2
  std::int32_t face = -1;                                      // -1: none within the limit
  Vec3 point;                                                  // m
  Vec3 weights;                                                // barycentric, of the face's corners
};

class Bvh {
 public:
  explicit Bvh(TriangleMesh mesh);

  const TriangleMesh& mesh() const { return mesh_; }

  // The closest point no farther than sqrt(limit2); of equally near faces the lowest-numbered.
  // A guess (the face nearest to a point close by) only makes it faster.
  ClosestPoint closest(const Vec3& p, double limit2 = std::numeric_limits<double>::infinity(),
                       std::int32_t guess = -1) const;

  // Whether the segment from a to b meets a face, ends included. One within the plane of a
  // face does not meet it.
  bool crosses(const Vec3& a, const Vec3& b) const;

  // Calls visit(face) for the faces whose box holds (x, y), whatever their z.
  template <class Visit>
  void visit_column(double x, double y, Visit visit) const;

  // Unit normal of the face, edge or vertex that holds the closest point.
  Vec3 pseudonormal(const ClosestPoint& hit) const;

  // +1 outside (where normals point), -1 inside, 0 on the surface.
  int side(const Vec3& p, const ClosestPoint& hit) const;

  const Vec3& face_normal(std::int32_t face) const { return face_normals_[face]; }

 private:
  struct Node {
    Vec3 low, high;
    std::int32_t first;  // leaf: first entry of order_; else index of the left child (right: next)
    std::int32_t count;  // faces in a leaf, 0 for an inner node
  };

  void build();
  void compute_normals();

  TriangleMesh mesh_;
  std::vector<Node> nodes_;
  std::vector<std::int32_t> order_;
  std::vector<std::array<Vec3, 3>> corners_;  // in the order of order_
  std::vector<Vec3> face_normals_, vertex_normals_;
  std::vector<std::array<Vec3, 3>> edge_normals_;  // of edge corner -> next corner
};

template <class Visit>
void Bvh::visit_column(double x, double y, Visit visit) const {
  std::array<std::int32_t, 64> stack;
  int top = 0;
  stack[top++] = 0;
  while (top > 0) {
    const Node& node = nodes_[stack[--top]];
    if (x < node.low.x || x > node.high.x || y < node.low.y || y > node.high.y) continue;
    if (node.count == 0) {
      stack[top++] = node.first;
      stack[top++] = node.first + 1;
    }
    for (std::int32_t i = node.first; i < node.first + node.count; ++i) visit(order_[i]);
  }
}

// Closest points of many points, in parallel.
std::vector<ClosestPoint> closest_points(const Bvh& bvh, const std::vector<Vec3>& points);

}  // namespace tledface
