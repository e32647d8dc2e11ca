// A tensor-product B-spline volume V(u, v, w) (a NURBS volume whose weights are equal), and its
// inverse: the parameters of a point, and the volume's direction along u there.
//
// Basis functions by the Cox-de Boor recursion (Piegl & Tiller, The NURBS Book, A2.2). Outside
// [0, 1] the polynomials of the first and last span go on, so that a point just outside the volume
// has parameters too. The inverse is a Newton iteration on V(u, v, w) = x with halved steps where
// the distance does not fall.
#pragma once
#include <array>
#include <vector>

#include "mesh/vec3.hpp"

namespace tledface {

constexpr int kMaxDegree = 5;

struct SplineVolume {
  std::array<int, 3> degree;                 // of u, v, w; 1 to kMaxDegree
  std::array<std::vector<double>, 3> knots;  // clamped, from 0 to 1
  std::vector<Vec3> control;                 // m, w fastest

  int count(int axis) const { return static_cast<int>(knots[axis].size()) - degree[axis] - 1; }
};

struct VolumeHit {
  Vec3 parameters;
  Vec3 along;            // dV/du, m
  double distance2 = 0;  // m^2, what is left between V and the point
};

// Throws InputError where counts of knots and control points do not fit each other.
void check_volume(const SplineVolume& volume);

// The parameters of each point, starting from the guesses, in parallel.
std::vector<VolumeHit> locate_in_volume(const SplineVolume& volume, const std::vector<Vec3>& points,
                                        const std::vector<Vec3>& guesses);

}  // namespace tledface
