#include "core/factors/prior_factor.h"

#include <utility>

#include "core/factors/checked_value.h"

namespace bundle {

PriorFactor::PriorFactor(FactorHead head, const Retraction& retraction, std::vector<double> value,
                         std::vector<double> information)
    : Factor(std::move(head), {retraction}, retraction.tangent_size()),
      value_(CheckedValue(name() + ": value", retraction, std::move(value))),
      whitening_(name() + ": information", std::move(information), retraction.tangent_size()) {}

bool PriorFactor::Evaluate(const double* const* values, double* residual,
                           double* const* jacobians) const {
  const Retraction& retraction = retractions()[0];
  retraction.Local(value_.data(), values[0], residual);
  if (jacobians != nullptr && jacobians[0] != nullptr) {
    retraction.InverseRightJacobian(residual, jacobians[0]);
  }
  whitening_.Apply(residual, jacobians, {retraction.tangent_size()});
  return true;
}

}  // namespace bundle
