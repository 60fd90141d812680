#pragma once

/// A relative measurement of two variables on one manifold: r = W Log(Z^-1 X_i^-1 X_j).
///
/// Z is X_j in the frame of X_i: the error of an edge of a pose graph, with the full logarithm in
/// SE(2) and SE(3); on Euclidean variables r = W (x_j - x_i - z). Differences of angles are taken
/// by the logarithm, never beyond pi.
///
/// With e = Log(Z^-1 X_i^-1 X_j), moving X_j to X_j Exp(d) multiplies Exp(e) by Exp(d) on the
/// right. Moving X_i to X_i Exp(d) puts Exp(-d) before X_j, and with B = X_j^-1 X_i
///
///   Z^-1 Exp(-d) X_i^-1 X_j = Z^-1 X_i^-1 X_j B Exp(-d) B^-1 = Exp(e) Exp(-Ad_B d),
///
///   J_i = -W J_r(e)^-1 Ad_B,        J_j = W J_r(e)^-1.

#include <vector>

#include "core/factors/factor.h"
#include "core/factors/whitening.h"

namespace bundle {

class BetweenFactor final : public Factor {
 public:
  /// Of two variables on the same manifold. Throws InputError if the measurement is no value of it
  /// or the information is not positive definite.
  BetweenFactor(FactorHead head, const Retraction& retraction, std::vector<double> measurement,
                std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> measurement_;
  Whitening whitening_;
};

}  // namespace bundle
