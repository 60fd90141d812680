#pragma once

/// What is known of one variable: r = W Log(Z^-1 X), X near Z with information W^T W.
///
/// The manifold may be any; on a Euclidean one r = W (x - z), a prior on a point or on a camera's
/// parameters. With e = Log(Z^-1 X), Log(Z^-1 X Exp(d)) = e + J_r(e)^-1 d + O(|d|^2), so that
/// J = W J_r(e)^-1.

#include <vector>

#include "core/factors/factor.h"
#include "core/factors/whitening.h"

namespace bundle {

class PriorFactor final : public Factor {
 public:
  /// Throws InputError if the value is none of the manifold or the information is not positive
  /// definite.
  PriorFactor(FactorHead head, const Retraction& retraction, std::vector<double> value,
              std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> value_;
  Whitening whitening_;
};

}  // namespace bundle
