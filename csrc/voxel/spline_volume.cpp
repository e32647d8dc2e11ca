// Evaluation and inversion of spline volumes. See spline_volume.hpp.
#include "voxel/spline_volume.hpp"

#include <string>

#include "core/error.hpp"
#include "core/threads.hpp"

namespace tledface {
namespace {

constexpr int kMaxIterations = 20;
constexpr int kMaxHalvings = 6;
// Parameters stay this near to [0, 1]: a spline runs away from what it was fitted to beyond that.
constexpr double kMargin = 0.1;
// Newton ends when parameters move by less than this.
constexpr double kSmallStep = 1e-10;
constexpr std::size_t kGrain = 2048;

struct Basis {
  int first = 0;  // index of the first control point
  std::array<double, kMaxDegree + 1> value{}, slope{};
};

// A2.2 for degree p, and slopes from the functions of degree p - 1 (A2.3 for one derivative).
void evaluate_basis(const std::vector<double>& knots, int p, double u, Basis& out) {
  const int n = static_cast<int>(knots.size()) - p - 1;
  int span = p;
  while (span < n - 1 && u >= knots[span + 1]) ++span;
  std::array<double, kMaxDegree + 1> left{}, right{}, lower{};
  out.first = span - p;
  out.value[0] = 1;
  for (int j = 1; j <= p; ++j) {
    if (j == p)
      for (int r = 0; r < p; ++r) lower[r] = out.value[r];
    left[j] = u - knots[span + 1 - j];
    right[j] = knots[span + j] - u;
    double saved = 0;
    for (int r = 0; r < j; ++r) {
      const double part = out.value[r] / (right[r + 1] + left[j - r]);
      out.value[r] = saved + right[r + 1] * part;
      saved = left[j - r] * part;
    }
    out.value[j] = saved;
  }
  for (int r = 0; r <= p; ++r) {
    const double before = r > 0 ? lower[r - 1] / (knots[span + r] - knots[span + r - p]) : 0;
    const double after = r < p ? lower[r] / (knots[span + r + 1] - knots[span + r + 1 - p]) : 0;
    out.slope[r] = p * (before - after);
  }
}

struct Evaluated {
  Vec3 position;
  std::array<Vec3, 3> slopes;  // along u, v, w
};

Evaluated evaluate(const SplineVolume& volume, const Vec3& at) {
  std::array<Basis, 3> basis;
  for (int axis = 0; axis < 3; ++axis)
    evaluate_basis(volume.knots[axis], volume.degree[axis], at[axis], basis[axis]);
  const auto& [bu, bv, bw] = basis;
  const std::size_t nv = static_cast<std::size_t>(volume.count(1));
  const std::size_t nw = static_cast<std::size_t>(volume.count(2));
  Evaluated out;
  for (int i = 0; i <= volume.degree[0]; ++i) {
    Vec3 plane, plane_v, plane_w;
    for (int j = 0; j <= volume.degree[1]; ++j) {
      const Vec3* row = &volume.control[((bu.first + i) * nv + bv.first + j) * nw + bw.first];
      Vec3 line, line_w;
      for (int k = 0; k <= volume.degree[2]; ++k) {
        line = line + bw.value[k] * row[k];
        line_w = line_w + bw.slope[k] * row[k];
      }
      plane = plane + bv.value[j] * line;
      plane_v = plane_v + bv.slope[j] * line;
      plane_w = plane_w + bv.value[j] * line_w;
    }
    out.position = out.position + bu.value[i] * plane;
    out.slopes[0] = out.slopes[0] + bu.slope[i] * plane;
    out.slopes[1] = out.slopes[1] + bu.value[i] * plane_v;
    out.slopes[2] = out.slopes[2] + bu.value[i] * plane_w;
  }
  return out;
}

// Solves [a b c] s = r by Cramer's rule; false where the three lie (nearly) in a plane.
bool solve(const std::array<Vec3, 3>& columns, const Vec3& r, Vec3& s) {
  const auto& [a, b, c] = columns;
  const Vec3 bc = cross(b, c);
  const double determinant = dot(a, bc);
  if (std::abs(determinant) <= 1e-9 * norm(a) * norm(b) * norm(c)) return false;
  s = (1 / determinant) * Vec3{dot(r, bc), dot(a, cross(r, c)), dot(a, cross(b, r))};
  return true;
}

VolumeHit locate(const SplineVolume& volume, const Vec3& point, Vec3 at) {
  const auto clamped = [](Vec3 p) {
    for (int axis = 0; axis < 3; ++axis) p[axis] = std::clamp(p[axis], -kMargin, 1 + kMargin);
    return p;
  };
  at = clamped(at);
  Evaluated here = evaluate(volume, at);
  double distance2 = norm2(point - here.position);
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    Vec3 step;
    if (!solve(here.slopes, point - here.position, step)) break;
    bool moved = false;
    for (int halving = 0; halving <= kMaxHalvings; ++halving, step = 0.5 * step) {
      const Vec3 next = clamped(at + step);
      const Evaluated there = evaluate(volume, next);
      const double left = norm2(point - there.position);
      if (!(left < distance2)) continue;
      moved = norm2(next - at) > kSmallStep * kSmallStep;
      at = next;
      here = there;
      distance2 = left;
      break;
    }
    if (!moved) break;
  }
  return {at, here.slopes[0], distance2};
}

}  // namespace

void check_volume(const SplineVolume& volume) {
  std::size_t expected = 1;
  for (int axis = 0; axis < 3; ++axis) {
    const int p = volume.degree[axis];
    if (p < 1 || p > kMaxDegree)
      throw InputError("degree: got " + std::to_string(p) + ", allowed is 1 to " +
                       std::to_string(kMaxDegree));
    if (volume.count(axis) <= p) throw InputError("knots: too few for the degree");
    expected *= static_cast<std::size_t>(volume.count(axis));
  }
  if (volume.control.size() != expected)
    throw InputError("control: got " + std::to_string(volume.control.size()) +
                     " points, the knots need " + std::to_string(expected));
}

std::vector<VolumeHit> locate_in_volume(const SplineVolume& volume, const std::vector<Vec3>& points,
                                        const std::vector<Vec3>& guesses) {
  std::vector<VolumeHit> hits(points.size());
  parallel_for_chunks(points.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) hits[i] = locate(volume, points[i], guesses[i]);
  });
  return hits;
}

}  // namespace tledface
