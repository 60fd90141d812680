#pragma once

/// Gaussian prior on several variables, from marginalisation (derived in linear_prior.cpp).

#include <string>
#include <vector>

#include "core/factors/factor.h"
#include "core/geometry/retraction.h"

namespace bundle {

class LinearPrior final : public Factor {
 public:
  /// Prior from Lambda = A^T A and eta = A^T b.
  struct Root {
    int rows = 0;
    std::vector<double> a;  ///< rows x n, row-major
    std::vector<double> b;
  };

  /// `lambda` is n x n, row-major, and `eta` n, where n is the sum of the tangent sizes. Throws
  /// InputError unless Lambda is symmetric, positive semidefinite and not zero, and eta is in its
  /// range.
  LinearPrior(FactorHead head, std::vector<Retraction> retractions,
              std::vector<std::vector<double>> linearization_point,
              const std::vector<double>& lambda, const std::vector<double>& eta);
  /// Prior from a square root; its number of columns is the sum of the tangent sizes.
  LinearPrior(FactorHead head, std::vector<Retraction> retractions,
              std::vector<std::vector<double>> linearization_point, Root root);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  static Root SquareRoot(const std::string& subject, int n, const std::vector<double>& lambda,
                         const std::vector<double>& eta);
  std::vector<std::vector<double>> linearization_point_;
  Root root_;
};

}  // namespace bundle
