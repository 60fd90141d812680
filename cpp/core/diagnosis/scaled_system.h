#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/covariance/reduced_system.h"
#include "core/linear/block_structure.h"
#include "core/linear/symmetric_product.h"

namespace bundle {

/// The reduced camera system S of a problem in units of its unknowns, diag(d) S diag(d), which has
/// ones on its diagonal. The rows and columns of undetermined unknowns are those of the identity.
class ScaledSystem {
 public:
  /// Copies S from `reduced` and keeps a reference to it. `squares`: the squared norms of the
  /// Jacobian's columns, before points were eliminated. `units`: the maximum meaningful change of
  /// each unknown.
  ScaledSystem(ReducedSystem* reduced, const std::vector<double>& squares,
               const std::vector<double>& units);

  int size() const { return static_cast<int>(scale_.size()); }
  /// d; 0 for undetermined unknowns.
  const std::vector<double>& scale() const { return scale_; }
  /// Bound of the rounding errors in z^T S z for the columns z of a matrix: a diagonal matrix times
  /// z.
  Eigen::MatrixXd Rounding(const Eigen::MatrixXd& z) const { return rounding_.asDiagonal() * z; }
  bool is_seen(int unknown) const { return scale_[unknown] > 0; }

  Eigen::MatrixXd Multiply(const Eigen::MatrixXd& x);

  /// Factorises the system plus `shift` on its diagonal. Returns -1, or the unknown at which it is
  /// not positive definite.
  int Factorize(double shift);
  /// The inverse of the factorised matrix, times x.
  Eigen::MatrixXd Solve(const Eigen::MatrixXd& x);

 private:
  void Scale();

  ReducedSystem* const reduced_;
  const BlockStructure compact_;  ///< structure of values_, without fill-in
  std::vector<double> scale_;
  Eigen::VectorXd rounding_;
  BlockValues values_;
  SymmetricProduct product_;
};

/// Squared norms of the Jacobian's columns for the unknowns of S, over the observations alone.
std::vector<double> SquaredColumns(const ReducedSystem& reduced);

}  // namespace bundle
