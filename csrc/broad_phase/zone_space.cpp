#include "broad_phase/zone_space.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "broad_phase/sliding_layout.hpp"

namespace tledface {
namespace {

// Part of a zone that may be cut off: no plane is sought further.
constexpr double kLittle = 0.01;
// Directions in which planes are tilted, and the angle between them, rad.
constexpr std::size_t kTurns = 12;
constexpr double kTurn = 0.2;
// A zone that shrinks to more vertices is taken as it was.
constexpr std::size_t kMostVertices = 24;

Vec3 closest_on_side(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 along = b - a;
  return a + std::clamp(dot(p - a, along) / norm2(along), 0.0, 1.0) * along;
}

Vec3 closest(const Vec3& p, const ZoneTriangle& t) {
  const Vec3 foot = p - dot(t.normal, p - t.corner[0]) * t.normal;
  Vec3 best = foot;
  double least = kFarOff;
  for (int k = 0; k < 3; ++k) {
    const Vec3 &a = t.corner[k], &b = t.corner[(k + 1) % 3], &c = t.corner[(k + 2) % 3];
    const Vec3 across = cross(t.normal, b - a);
    if (dot(across, foot - a) * dot(across, c - a) >= 0) continue;
    const Vec3 q = closest_on_side(p, a, b);
    if (norm2(p - q) < least) {
      least = norm2(p - q);
      best = q;
    }
  }
  return best;
}

// Cosines and sines of the angles of planes, those ahead first.
using Turns = std::array<std::array<double, 2>, kTurns>;
const Turns& turns() {
  static const Turns all = [] {
    Turns made;
    for (std::size_t turn = 0; turn < kTurns; ++turn) {
      const double angle = (turn % 2 ? -kTurn : kTurn) * static_cast<double>((turn + 1) / 2);
      made[turn] = {std::cos(angle), std::sin(angle)};
    }
    return made;
  }();
  return all;
}

}  // namespace

ZoneTriangle zone_triangle(const double* reals) {
  const auto vec = [&](int k) { return Vec3{reals[k], reals[k + 1], reals[k + 2]}; };
  return {
      {vec(0), vec(3), vec(6)}, vec(TRIANGLE_NORMAL), vec(TRIANGLE_BALL), reals[TRIANGLE_BALL + 3]};
}

int shared_side(const ZoneTriangle& a, const ZoneTriangle& b) {
  bool has[3];
  for (int k = 0; k < 3; ++k)
    has[k] = a.corner[k] == b.corner[0] || a.corner[k] == b.corner[1] || a.corner[k] == b.corner[2];
  for (int k = 0; k < 3; ++k)
    if (has[k] && has[(k + 1) % 3] && !has[(k + 2) % 3]) return k;
  return -1;
}

Vec3 inwards(const ZoneTriangle& t, int k) {
  const Vec3 in = unit(cross(t.normal, t.corner[(k + 1) % 3] - t.corner[k]));
  return dot(in, t.corner[(k + 2) % 3] - t.corner[k]) < 0 ? -1.0 * in : in;
}

// What keeps `other` farther than a zone's own part: nothing, or a border. A plane that has the
// other behind it tells how far that is at least, so planes are tried until one leaves the zone
// whole, else the one that leaves most of its width is taken (a zone over an edge is long and thin:
// what is little along it is all of it across): the other's own, those that tilt as little as they
// may about its nearest corner, in several directions, and those across ways to it.
void ZoneSpace::keep_off(const ZoneTriangle& other, std::int32_t number, double rounding) {
  const Vec3 amid = samples.front(), up = unit(rise);
  Vec3 best;
  double kept = -kFarOff, lift = 0;
  const auto try_plane = [&](const Vec3& n, const Vec3& q) {
    const Vec3 way = n - rise;
    const double from = dot(n, q) - dot(rise, on);
    double least = kFarOff, most = -kFarOff;
    for (const Vec3& v : vertices) {
      const double ahead = dot(way, v) - from;
      least = std::min(least, ahead);
      most = std::max(most, ahead);
    }
    if (least >= -rounding) return true;
    if (most > least && norm2(way) > kFlat * kFlat && most / (most - least) > kept) {
      kept = most / (most - least);
      best = n;
      lift = dot(n, q);
    }
    return false;
  };
  const double side = dot(other.normal, amid - other.corner[0]) < 0 ? -1.0 : 1.0;
  if (try_plane(side * other.normal, other.corner[0])) return;
  const Vec3 pivot = *std::min_element(
      other.corner, other.corner + 3,
      [&](const Vec3& a, const Vec3& b) { return norm2(a - amid) < norm2(b - amid); });
  const Vec3 away = unit(amid - pivot - dot(amid - pivot, up) * up), across = cross(up, away);
  double height[3], back[3], aside[3];
  for (int k = 0; k < 3; ++k) {
    const Vec3 way = other.corner[k] - pivot;
    height[k] = dot(up, way);
    back[k] = -dot(away, way);
    aside[k] = -dot(across, way);
  }
  // Where `rise` is longer than the way up a plane has to be tilted for that too: this tilt loses
  // least.
  const double best_tilt = std::sqrt(2 * std::max(norm(rise) - 1, 0.0));
  for (const auto& [cosine, sine] : turns()) {
    double off[3], needed = 0;
    bool can = true;
    for (int k = 0; k < 3; ++k) {
      off[k] = cosine * back[k] + sine * aside[k];
      if (!(height[k] > 0)) continue;
      can = can && off[k] > 0;
      if (can) needed = std::max(needed, height[k] / off[k]);
    }
    for (const double tilt : {needed, best_tilt}) {
      if (!can || tilt == 0 || (tilt < needed)) continue;
      for (int k = 0; k < 3; ++k) can = can && height[k] - tilt * off[k] <= 0.1 * rounding;
      if (can && try_plane(unit(up + tilt * (cosine * away + sine * across)), pivot)) return;
    }
  }
  for (const Vec3& p : samples) {
    if (kept > 1 - kLittle) break;
    const Vec3 q = closest(p, other), way = p - q;
    if (norm(way) > rounding && try_plane(unit(way), q)) return;
  }
  if (!(kept > -kFarOff)) {  // nearer everywhere
    close();
    vertices.clear();
    return;
  }
  const Vec3 out = rise - best;
  const double length = norm(out);
  add({(1 / length) * out, (dot(rise, on) - lift) / length, number}, rounding);
}

void ZoneSpace::add(const ZoneBorder& border, double rounding) {
  borders.push_back(border);
  // What is left, by its vertices; where a plane cuts it, cuts between any two of them have its own
  // among them, and lie in it.
  std::vector<Vec3> left;
  const auto ahead = [&](const Vec3& v) { return border.limit - dot(border.outward, v); };
  for (const Vec3& v : vertices) {
    if (ahead(v) < -rounding) continue;
    left.push_back(v);
    for (const Vec3& w : vertices)
      if (ahead(w) < -rounding && ahead(v) > rounding)
        left.push_back(v + (ahead(v) / (ahead(v) - ahead(w))) * (w - v));
  }
  if (left.size() <= kMostVertices) vertices = std::move(left);
}

}  // namespace tledface
