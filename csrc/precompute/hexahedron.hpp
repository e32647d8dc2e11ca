// The geometry of a distorted hexahedron with one integration point, from its eight corners.
//
// Gradients are means over the element, (1/V) int dN_a/dX dV (Flanagan & Belytschko 1981), so that
// a linear displacement of any mesh gives the exact mean stress and the patch test holds; at the
// centre of a box they are +-1/(4 h). Hourglass amplitudes are s^m = sum_a gamma_a^m u_a with
// gamma^m = h^m - sum_j c_mj dN/dX_j, c_mj = sum_a h_a^m X_aj: zero for linear displacements.
// Stiffness against them is that of the box that the element is nearest to: its axes are the
// rotation of the centre's Jacobian (polar decomposition), its edges the lengths of that one's
// columns. Exact for a box in any direction.
#pragma once
#include <array>

namespace tledface {

struct Hexahedron {
  double volume = 0;                // m^3
  std::array<double, 24> gradient;  // [3 a + j], 1/m
  std::array<double, 12> offset;    // c_mj [3 m + j], m; m: xy, yz, zx, xyz
  std::array<double, 9> axes;       // [3 d + j]: unit vector of the box's axis d
  std::array<double, 3> sides;      // m
  // Largest eigenvalue of the element at rest, hourglass modes included, over that of its linear
  // part; at least 1. They are orthogonal in a box, where it is 1.
  double stiffening = 1;

  // sum_a dN_a/dX_i dN_a/dX_j: xx yy zz xy yz xz, 1/m^2.
  std::array<double, 6> gradient_square() const;
};

// x: 8 corners, 3 coordinates each, corner bits 1 xi, 2 eta, 4 zeta. False where the Jacobian is
// not positive at the centre and the eight Gauss points.
bool make_hexahedron(const double* x, Hexahedron& result);

// Largest eigenvalue of a symmetric tensor xx yy zz xy yz xz.
double largest_eigenvalue(const std::array<double, 6>& tensor);

// omega^2 rho / 4 of the element's linear part: lambda 2 tr G + 2 mu 2 |G|, G the gradient square.
double linear_stiffness(const Hexahedron& hexahedron, double lambda, double mu);

struct HourglassStiffness {
  bool physical = true;
  double kappa = 0;                       // of the kappa form
  std::array<double, 3> bending_modulus;  // Pa, of the physical form
};

// Finds `stiffening` for these moduli (Pa).
void set_stiffening(Hexahedron& hexahedron, double lambda, double mu,
                    const HourglassStiffness& hourglass);

// Of the kappa form: k of f^m = k s^m, N/m (Joldes, Wittek & Miller 2008).
double kappa_stiffness(const Hexahedron& hexahedron, double kappa, double modulus);

}  // namespace tledface
