#pragma once

/// Retractions: manifolds of variables, and the tangent coordinates in which solvers take steps.
///
/// All manifolds are Lie groups X with the right perturbation
///
///   Plus(X, d) = X Exp(d),      Local(X, Y) = Log(X^-1 Y),      Plus(X, Local(X, Y)) = Y.
///
/// | manifold  | stored                    | tangent coordinates d                            |
/// |-----------|---------------------------|--------------------------------------------------|
/// | euclidean | n numbers                 | the same n; Exp is the identity, X + d           |
/// | so2       | angle                     | angle                                            |
/// | so3       | qx qy qz qw               | rotation vector (3)                              |
/// | se2       | x y angle                 | x y angle, in the frame of X (rigid_motion.h)   |
/// | se3       | qx qy qz qw tx ty tz      | rotation (3), translation (3), in the frame of X |
///
/// Angles are radians. The angles of so2 and se2 keep their turns in Plus and lose them in Local.
/// A factor's Jacobian J at X is the derivative of its residual with respect to d at d = 0:
/// r(Plus(X, d)) = r(X) + J d + O(|d|^2). At d other than 0, the Jacobian w.r.t. d is J times the
/// right Jacobian J_r, because Exp(d + e) = Exp(d) Exp(J_r(d) e) + O(|e|^2).
///
/// The chart starts anew at every X: a solver that accepts a step re-anchors it, so that it is
/// regular for any sum of steps. Quaternions may have any nonzero norm; Plus returns unit
/// quaternions. Matrices are row-major.

#include <string>
#include <vector>

namespace bundle {

enum class Manifold { kEuclidean, kSo2, kSo3, kSe2, kSe3 };

class Retraction {
 public:
  /// Throws InputError if a value of the manifold has not `ambient_size` numbers.
  Retraction(Manifold manifold, int ambient_size);

  Manifold manifold() const { return manifold_; }
  const char* name() const;  ///< "se3"
  int ambient_size() const { return ambient_size_; }
  int tangent_size() const { return tangent_size_; }

  /// out = X Exp(d); `out` may be `x`.
  void Plus(const double* x, const double* delta, double* out) const;
  /// delta = Log(X^-1 Y), of an angle of at most pi.
  void Local(const double* x, const double* y, double* delta) const;
  /// out = X^-1 Y
  void Between(const double* x, const double* y, double* out) const;
  /// X Exp(d) X^-1 = Exp(Ad d), tangent size squared.
  void Adjoint(const double* x, double* out) const;
  /// J_r(d) and its inverse, which exists for angles below 2 pi; tangent size squared.
  void RightJacobian(const double* delta, double* out) const;
  void InverseRightJacobian(const double* delta, double* out) const;
  /// Scales the quaternion to norm 1. False if it has none: all zeros, or not finite.
  bool Normalize(double* x) const;
  /// "x", "angle", "rotation y", ...: a tangent coordinate.
  std::string CoordinateName(int coordinate) const;

  bool operator==(const Retraction& other) const {
    return manifold_ == other.manifold_ && ambient_size_ == other.ambient_size_;
  }
  bool operator!=(const Retraction& other) const { return !(*this == other); }

 private:
  Manifold manifold_;
  int ambient_size_;
  int tangent_size_;
};

/// Finds a retraction by its name in the table above. Throws InputError for any other name, or a
/// size that does not fit.
Retraction RetractionFromName(const std::string& name, int ambient_size);

/// A variable of a problem: its value, its retraction, and its constant coordinates.
struct Block {
  std::string name;  ///< for messages
  Retraction retraction;
  std::vector<double> value;  ///< where the chart starts, as the manifold stores it
  /// One entry per tangent coordinate, true if it is constant; empty: all are free.
  std::vector<bool> held;
  /// Bounds of Euclidean values, one entry per number, infinite for a number without a bound;
  /// empty: no bounds.
  std::vector<double> lower;
  std::vector<double> upper;

  bool IsHeld(int coordinate) const { return !held.empty() && held[coordinate]; }

  int NumFree() const {
    int count = 0;
    for (int i = 0; i < retraction.tangent_size(); ++i) count += IsHeld(i) ? 0 : 1;
    return count;
  }
};

}  // namespace bundle
