#include "precompute/hexahedron.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include "core/error.hpp"
#include "core/threads.hpp"
#include "precompute/voxel_model.hpp"

namespace tledface {
namespace {

using Matrix = std::array<double, 9>;  // row-major

constexpr int kPowerIterations = 60;
// What a power iteration from below may lack.
constexpr double kPowerMargin = 1.03;
// Stiffening below this is rounding and margin.
constexpr double kNoStiffening = 1.02;

double sign(int corner, int bit) { return corner >> bit & 1 ? 1.0 : -1.0; }

double hourglass_sign(int corner, int mode) {
  const double x = sign(corner, 0), y = sign(corner, 1), z = sign(corner, 2);
  return mode == 0 ? x * y : mode == 1 ? y * z : mode == 2 ? z * x : x * y * z;
}

// dX_i/dxi_j [3 i + j] at a point of the reference cube -1 ... 1.
Matrix jacobian(const double* x, const double* xi) {
  Matrix result{};
  for (int a = 0; a < 8; ++a)
    for (int j = 0; j < 3; ++j) {
      double slope = sign(a, j) / 8;
      for (int k = 0; k < 3; ++k)
        if (k != j) slope *= 1 + sign(a, k) * xi[k];
      for (int i = 0; i < 3; ++i) result[3 * i + j] += x[3 * a + i] * slope;
    }
  return result;
}

Matrix cofactors(const Matrix& m) {
  Matrix c;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const int a = (i + 1) % 3, b = (i + 2) % 3, d = (j + 1) % 3, e = (j + 2) % 3;
      c[3 * i + j] = m[3 * a + d] * m[3 * b + e] - m[3 * a + e] * m[3 * b + d];
    }
  return c;
}

double determinant(const Matrix& m, const Matrix& cof) {
  return m[0] * cof[0] + m[1] * cof[1] + m[2] * cof[2];
}

// The rotation of m = R U, by Newton's iteration R <- (R + R^-T)/2 (Higham 1986).
Matrix rotation_of(Matrix m) {
  for (int iteration = 0; iteration < 100; ++iteration) {
    const Matrix cof = cofactors(m);
    const double J = determinant(m, cof);
    double change = 0;
    for (int i = 0; i < 9; ++i) {
      const double next = 0.5 * (m[i] + cof[i] / J);
      change = std::max(change, std::abs(next - m[i]));
      m[i] = next;
    }
    if (change < 1e-15) break;
  }
  return m;
}

// Forces f (24) of the linear element at rest for a displacement u (24).
void rest_force(const Hexahedron& h, double lambda, double mu, const HourglassStiffness& form,
                const double* u, double* f) {
  double grad[3][3] = {}, s[4][3] = {};
  for (int a = 0; a < 8; ++a)
    for (int c = 0; c < 3; ++c) {
      for (int j = 0; j < 3; ++j) grad[c][j] += u[3 * a + c] * h.gradient[3 * a + j];
      for (int m = 0; m < 4; ++m) s[m][c] += hourglass_sign(a, m) * u[3 * a + c];
    }
  for (int m = 0; m < 4; ++m)
    for (int c = 0; c < 3; ++c)
      for (int j = 0; j < 3; ++j) s[m][c] -= grad[c][j] * h.offset[3 * m + j];
  const double trace = grad[0][0] + grad[1][1] + grad[2][2];
  double P[3][3];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      P[i][j] = h.volume * ((i == j ? lambda * trace : 0) + mu * (grad[i][j] + grad[j][i]));
  double g[4][3];  // mode forces
  if (form.physical) {
    const double nu = lambda / (2 * (lambda + mu)), youngs = 2 * mu * (1 + nu);
    double q[4][3], local[4][3];
    for (int m = 0; m < 4; ++m)
      for (int d = 0; d < 3; ++d) {
        q[m][d] = 0;
        for (int j = 0; j < 3; ++j) q[m][d] += h.axes[3 * d + j] * s[m][j] / (4 * h.sides[d]);
      }
    double bend[3];
    for (int d = 0; d < 3; ++d) bend[d] = h.volume / 3 * form.bending_modulus[d] / (1 - nu * nu);
    const double twist = h.volume / 3 * mu, odd = h.volume / 9 * youngs;
    const auto& L = h.sides;
    const double twist_z = twist * (L[0] / L[1] * q[1][0] + L[1] / L[0] * q[2][1]),
                 twist_x = twist * (L[1] / L[2] * q[2][1] + L[2] / L[1] * q[0][2]),
                 twist_y = twist * (L[0] / L[2] * q[1][0] + L[2] / L[0] * q[0][2]);
    local[0][0] = bend[1] * (q[0][0] + nu * q[1][2]);
    local[0][1] = bend[0] * (q[0][1] + nu * q[2][2]);
    local[0][2] = L[2] / L[1] * twist_x + L[2] / L[0] * twist_y;
    local[1][0] = L[0] / L[1] * twist_z + L[0] / L[2] * twist_y;
    local[1][1] = bend[2] * (q[1][1] + nu * q[2][0]);
    local[1][2] = bend[1] * (q[1][2] + nu * q[0][0]);
    local[2][0] = bend[2] * (q[2][0] + nu * q[1][1]);
    local[2][1] = L[1] / L[0] * twist_z + L[1] / L[2] * twist_x;
    local[2][2] = bend[0] * (q[2][2] + nu * q[0][1]);
    for (int d = 0; d < 3; ++d) local[3][d] = odd * q[3][d];
    for (int m = 0; m < 4; ++m)
      for (int j = 0; j < 3; ++j) {
        g[m][j] = 0;
        for (int d = 0; d < 3; ++d) g[m][j] += h.axes[3 * d + j] * local[m][d] / (4 * h.sides[d]);
      }
  } else {
    const double k = kappa_stiffness(h, form.kappa, lambda + 2 * mu);
    for (int m = 0; m < 4; ++m)
      for (int c = 0; c < 3; ++c) g[m][c] = k * s[m][c];
  }
  for (int a = 0; a < 8; ++a)
    for (int c = 0; c < 3; ++c) {
      double sum = 0;
      for (int j = 0; j < 3; ++j) {
        double Q = P[c][j];
        for (int m = 0; m < 4; ++m) Q -= g[m][c] * h.offset[3 * m + j];
        sum += Q * h.gradient[3 * a + j];
      }
      for (int m = 0; m < 4; ++m) sum += hourglass_sign(a, m) * g[m][c];
      f[3 * a + c] = sum;
    }
}

}  // namespace

std::array<double, 6> Hexahedron::gradient_square() const {
  std::array<double, 6> G{};
  for (int a = 0; a < 8; ++a) {
    const double* b = &gradient[3 * a];
    G[0] += b[0] * b[0];
    G[1] += b[1] * b[1];
    G[2] += b[2] * b[2];
    G[3] += b[0] * b[1];
    G[4] += b[1] * b[2];
    G[5] += b[0] * b[2];
  }
  return G;
}

bool make_hexahedron(const double* x, Hexahedron& h) {
  h.gradient.fill(0);
  h.volume = 0;
  // Two points an axis integrate the products of two Jacobian columns and a slope exactly.
  const double at = 1 / std::sqrt(3.0);
  for (int point = 0; point < 8; ++point) {
    const double xi[3] = {sign(point, 0) * at, sign(point, 1) * at, sign(point, 2) * at};
    const Matrix m = jacobian(x, xi), cof = cofactors(m);
    const double J = determinant(m, cof);
    if (!(J > 0)) return false;
    h.volume += J;
    for (int a = 0; a < 8; ++a)
      for (int j = 0; j < 3; ++j) {
        double slope = sign(a, j) / 8;
        for (int k = 0; k < 3; ++k)
          if (k != j) slope *= 1 + sign(a, k) * xi[k];
        for (int i = 0; i < 3; ++i) h.gradient[3 * a + i] += cof[3 * i + j] * slope;
      }
  }
  for (double& value : h.gradient) value /= h.volume;
  h.offset.fill(0);
  for (int a = 0; a < 8; ++a)
    for (int m = 0; m < 4; ++m)
      for (int j = 0; j < 3; ++j) h.offset[3 * m + j] += hourglass_sign(a, m) * x[3 * a + j];
  const double centre[3] = {0, 0, 0};
  const Matrix m = jacobian(x, centre);
  if (!(determinant(m, cofactors(m)) > 0)) return false;
  const Matrix rotation = rotation_of(m);
  for (int d = 0; d < 3; ++d) {
    double square = 0;
    for (int i = 0; i < 3; ++i) {
      h.axes[3 * d + i] = rotation[3 * i + d];
      square += m[3 * i + d] * m[3 * i + d];
    }
    h.sides[d] = 2 * std::sqrt(square);
  }
  h.stiffening = 1;
  return true;
}

double largest_eigenvalue(const std::array<double, 6>& t) {
  // Closed form for a symmetric 3 x 3 matrix (Smith 1961).
  const double mean = (t[0] + t[1] + t[2]) / 3;
  const double off = t[3] * t[3] + t[4] * t[4] + t[5] * t[5];
  const double a = t[0] - mean, b = t[1] - mean, c = t[2] - mean;
  const double p = std::sqrt((a * a + b * b + c * c + 2 * off) / 6);
  if (!(p > 1e-14 * std::abs(mean))) return mean + p;
  const double det =
      a * (b * c - t[4] * t[4]) - t[3] * (t[3] * c - t[4] * t[5]) + t[5] * (t[3] * t[4] - b * t[5]);
  const double r = std::clamp(det / (2 * p * p * p), -1.0, 1.0);
  return mean + 2 * p * std::cos(std::acos(r) / 3);
}

double linear_stiffness(const Hexahedron& h, double lambda, double mu) {
  const auto G = h.gradient_square();
  return 2 * lambda * (G[0] + G[1] + G[2]) + 4 * mu * largest_eigenvalue(G);
}

double kappa_stiffness(const Hexahedron& h, double kappa, double modulus) {
  const auto G = h.gradient_square();
  return kappa * modulus * h.volume / 8 * (G[0] + G[1] + G[2]);
}

void set_stiffening(Hexahedron& h, double lambda, double mu, const HourglassStiffness& form) {
  double u[24], f[24];
  for (int i = 0; i < 24; ++i) u[i] = std::sin(1.0 + 7.3 * i * i);  // a part of every mode
  double eigenvalue = 0;
  for (int iteration = 0; iteration < kPowerIterations; ++iteration) {
    rest_force(h, lambda, mu, form, u, f);
    double square = 0;
    for (const double value : f) square += value * value;
    const double length = std::sqrt(square);
    if (!(length > 0)) return;
    eigenvalue = length;
    for (int i = 0; i < 24; ++i) u[i] = f[i] / length;
  }
  // omega^2 rho V/8 is the eigenvalue, so rho omega^2/4 is 2/V times it.
  const double ratio = kPowerMargin * 2 / h.volume * eigenvalue / linear_stiffness(h, lambda, mu);
  h.stiffening = ratio > kNoStiffening ? ratio : 1;
}

double VoxelModel::shortest_edge() const {
  if (!conforming()) return *std::min_element(voxel.begin(), voxel.end());
  double shortest = hexahedra[0].sides[0];
  for (const Hexahedron& h : hexahedra)
    shortest = std::min(shortest, *std::min_element(h.sides.begin(), h.sides.end()));
  return shortest;
}

std::array<double, 3> VoxelModel::way(std::size_t from, std::size_t to) const {
  std::array<double, 3> result;
  for (int c = 0; c < 3; ++c)
    result[c] = conforming() ? positions[3 * to + c] - positions[3 * from + c]
                             : (node_ijk[3 * to + c] - node_ijk[3 * from + c]) * voxel[c];
  return result;
}

static void stiffen(VoxelModel& model, std::size_t e, const HourglassStiffness& form) {
  const double mu = model.shear_modulus[e], lambda = model.bulk_modulus[e] - 2 * mu / 3;
  set_stiffening(model.hexahedra[e], lambda, mu, form);
}

void set_kappa_stiffening(VoxelModel& model, double kappa) {
  parallel_for_chunks(model.n_elements(), 256, [&](std::size_t begin, std::size_t end) {
    for (std::size_t e = begin; e < end; ++e) stiffen(model, e, {false, kappa, {}});
  });
}

void set_hexahedra(VoxelModel& model, std::vector<double> positions,
                   std::vector<std::int32_t> corners) {
  const std::size_t n = corners.size() / 8;
  if (corners.empty() || corners.size() % 8 || model.shear_modulus.size() != n ||
      model.bulk_modulus.size() != n || model.bending_modulus.size() != 3 * n)
    throw InputError("mesh: its arrays differ in length");
  const auto n_nodes = static_cast<std::int64_t>(positions.size() / 3);
  for (const double x : positions)
    if (!std::isfinite(x)) throw InputError("mesh: a node's position is not finite");
  for (const std::int32_t node : corners)
    if (node < 0 || node >= n_nodes)
      throw InputError("mesh: node " + std::to_string(node) + " of an element does not exist");
  model.positions = std::move(positions);
  model.corners = std::move(corners);
  model.hexahedra.resize(n);
  std::vector<std::uint8_t> bad(n, 0);
  parallel_for_chunks(n, 256, [&](std::size_t begin, std::size_t end) {
    for (std::size_t e = begin; e < end; ++e) {
      double x[24];
      for (int a = 0; a < 8; ++a)
        for (int i = 0; i < 3; ++i)
          x[3 * a + i] = model.positions[3 * model.corners[8 * e + a] + i];
      bad[e] = !make_hexahedron(x, model.hexahedra[e]);
      if (bad[e]) continue;
      const double* bend = &model.bending_modulus[3 * e];
      stiffen(model, e, {true, 0, {bend[0], bend[1], bend[2]}});
    }
  });
  const auto first = std::find(bad.begin(), bad.end(), 1);
  if (first != bad.end())
    throw InputError("mesh: element " + std::to_string(first - bad.begin()) +
                     " is inside out or degenerate (" +
                     std::to_string(std::count(bad.begin(), bad.end(), 1)) +
                     " such); corners in VTK hexahedron order with a positive Jacobian are needed");
}

}  // namespace tledface
