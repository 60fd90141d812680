#pragma once

/// A factor whose residual and Jacobians are a Python function.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <vector>

#include "core/factors/factor.h"

/// Calls function(values, jacobians wanted). It returns (residual, Jacobians or None) with checked
/// shapes (python/bundle/graphs/factors/factors.py), or None if the residual has no value.
/// Takes the GIL for each call. Evaluate throws Python's exceptions, with KeyboardInterrupt as
/// bundle::Interrupted.
class PythonFactor final : public bundle::Factor {
 public:
  /// Requires the GIL. Calls the function once, at `start`, to get the number of residuals.
  PythonFactor(bundle::FactorHead head, std::vector<bundle::Retraction> retractions,
               pybind11::object function, const std::vector<const double*>& start);
  ~PythonFactor() override;

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;
  bool IsThreadSafe() const override { return false; }

 private:
  pybind11::object function_;
};
