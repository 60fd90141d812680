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
  /// `num_dependent`: how many of them follow from the others.
  PythonFactor(bundle::FactorHead head, std::vector<bundle::Retraction> retractions,
               pybind11::object function, int num_dependent,
               const std::vector<const double*>& start);
  ~PythonFactor() override;

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;
  bool IsThreadSafe() const override { return false; }
  int num_measurements() const override { return num_residuals() - num_dependent_; }

 private:
  pybind11::object function_;
  const int num_dependent_;
};
