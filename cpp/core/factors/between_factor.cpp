#include "core/factors/between_factor.h"

#include <algorithm>
#include <utility>

#include "core/factors/checked_value.h"

namespace bundle {

BetweenFactor::BetweenFactor(FactorHead head, const Retraction& retraction,
                             std::vector<double> measurement, std::vector<double> information)
    : Factor(std::move(head), {retraction, retraction}, retraction.tangent_size()),
      measurement_(CheckedValue(name() + ": measurement", retraction, std::move(measurement))),
      whitening_(name() + ": information", std::move(information), retraction.tangent_size()) {}

bool BetweenFactor::Evaluate(const double* const* values, double* residual,
                             double* const* jacobians) const {
  const Retraction& retraction = retractions()[0];
  const int n = retraction.tangent_size();
  std::vector<double> between(retraction.ambient_size());
  retraction.Between(values[0], values[1], between.data());
  retraction.Local(measurement_.data(), between.data(), residual);
  if (jacobians == nullptr) {
    whitening_.Apply(residual, 1);
    return true;
  }
  std::vector<double> inverse(n * n), adjoint(n * n);
  retraction.InverseRightJacobian(residual, inverse.data());
  if (jacobians[0] != nullptr) {
    retraction.Between(values[1], values[0], between.data());
    retraction.Adjoint(between.data(), adjoint.data());
    for (int r = 0; r < n; ++r) {
      for (int c = 0; c < n; ++c) {
        double sum = 0;
        for (int k = 0; k < n; ++k) sum += inverse[r * n + k] * adjoint[k * n + c];
        jacobians[0][r * n + c] = -sum;
      }
    }
  }
  if (jacobians[1] != nullptr) std::copy(inverse.begin(), inverse.end(), jacobians[1]);
  whitening_.Apply(residual, jacobians, {n, n});
  return true;
}

}  // namespace bundle
