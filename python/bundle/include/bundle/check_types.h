#pragma once

/// Records of numerical Jacobians (bundle/numeric_jacobian.h), and of a check with its points,
/// mistakes and entries (bundle/check_report.h).

#include <string>
#include <vector>

namespace bundle {

/// A Jacobian of all blocks, concatenated, row-major, num_residuals x columns, and for each entry a
/// bound on its error. The bound is infinite where there is no derivative.
struct NumericJacobian {
  std::vector<double> values;
  std::vector<double> uncertainty;
};

struct ReferenceJacobians {
  NumericJacobian ambient;
  NumericJacobian tangent;
};

/// Known scales of a cost function.
struct KnownScales {
  /// Bounds of the first step of each ambient column, unless empty: the distance to a singularity.
  std::vector<double> largest_steps;
  /// Size of the numbers whose difference is a residual, one per residual unless empty: their
  /// rounding errors are also those of the residual.
  std::vector<double> minuends;
};

/// Columns of a parameter block in the tangent space.
struct CheckedBlock {
  std::string name;
  int size = 0;
  bool is_curved = false;
};

/// Jacobians of all blocks at one point: num_residuals x columns, row-major.
struct CheckedPoint {
  int number = 0;
  std::vector<double> residuals;
  std::vector<double> analytic, reference, uncertainty;
};

/// A mistake: kind and words of bundle.check_gradients.
struct GradientFinding {
  std::string kind;
  std::string sentence;
  std::vector<int> columns;
};

/// An entry of a Jacobian.
struct GradientEntry {
  int sample = 0, residual = 0, column = 0;
  double analytic = 0, reference = 0;
  double error = 0;  ///< relative, minus the uncertainty of the reference
};

}  // namespace bundle
