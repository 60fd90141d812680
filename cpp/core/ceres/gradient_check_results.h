#pragma once

#include <string>
#include <vector>

namespace bundle {

/// A Jacobian of all blocks side by side, row-major, num_residuals x columns, and for each entry a
/// bound on its error, infinite where there is no derivative.
struct NumericJacobian {
  std::vector<double> values;
  std::vector<double> uncertainty;
};

struct ReferenceJacobians {
  NumericJacobian ambient;
  NumericJacobian tangent;
};

/// What GradientChecker found. Matrices are num_residuals x tangent columns, row-major; empty where
/// the cost function could not be evaluated at a point that it asked for.
struct GradientCheckerProbe {
  bool agrees = false;  ///< its own verdict at the given relative precision
  std::vector<double> local_jacobian;
  std::vector<double> local_numeric_jacobian;
  std::string message;  ///< its error_log
};

}  // namespace bundle
