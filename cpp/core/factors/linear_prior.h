#pragma once

/// A dense quadratic prior on several variables, as marginalisation leaves it:
///
///   1/2 d^T Lambda d - eta^T d,        d = (Log(X_1*^-1 X_1), Log(X_2*^-1 X_2), ...),
///
/// about linearization points X*, with Lambda symmetric and positive semidefinite: what a gauge
/// leaves free stays free. As a residual it needs a square root. With D = diag(Lambda)^(1/2), so
/// that units do not matter, and the eigenvalues and eigenvectors of D^-1 Lambda D^-1 = V S V^T,
///
///   A = S^(1/2) V^T D,        b = S^(-1/2) V^T D^-1 eta        give        A^T A = Lambda,  A^T b
///   = eta,
///
/// where only eigenvalues above rounding are kept, one residual each:
///
///   r = A d - b,        1/2 ||r||^2 = 1/2 d^T Lambda d - eta^T d + 1/2 ||b||^2,
///
/// and dr/dX_k = A_k J_r(d_k)^-1. The constant makes the least cost 0. eta must not point along a
/// direction that Lambda leaves free: the cost would have no minimum.

#include <vector>

#include "core/factors/factor.h"

namespace bundle {

class LinearPrior final : public Factor {
 public:
  /// `lambda` is n x n, row-major, and `eta` n, n the sum of the tangent sizes. Throws InputError
  /// unless Lambda is symmetric, positive semidefinite, not zero, and eta in its range.
  LinearPrior(FactorHead head, std::vector<Retraction> retractions,
              std::vector<std::vector<double>> linearization_point,
              const std::vector<double>& lambda, const std::vector<double>& eta);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  struct Root {
    int rows = 0;
    std::vector<double> a;  ///< rows x n, row-major
    std::vector<double> b;
  };
  static Root SquareRoot(const std::string& subject, int n, const std::vector<double>& lambda,
                         const std::vector<double>& eta);
  LinearPrior(FactorHead head, std::vector<Retraction> retractions,
              std::vector<std::vector<double>> linearization_point, Root root);

  std::vector<std::vector<double>> linearization_point_;
  Root root_;
};

}  // namespace bundle
