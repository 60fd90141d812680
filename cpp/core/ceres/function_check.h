#pragma once

/// gradient_check.h for residuals that are not Ceres' classes; no header of Ceres is needed here.

#include <functional>
#include <string>
#include <vector>

#include "core/ceres/gradient_check_results.h"

namespace bundle {

/// As ceres::CostFunction::Evaluate: Jacobians row-major, `jacobians` or single ones may be
/// nullptr; false where there is no value.
using ResidualFunction =
    std::function<bool(double const* const* parameters, double* residuals, double** jacobians)>;

/// What MakeManifold (manifolds.h) takes.
struct ManifoldSpec {
  std::string name;
  std::vector<int> constant;
};

/// A function at a point of its parameters.
struct FunctionAtPoint {
  ResidualFunction function;
  int num_residuals = 0;
  std::vector<std::vector<double>> blocks;
  std::vector<ManifoldSpec> manifolds;  ///< one a block
};

/// Both throw InputError if a manifold does not fit its block.
ReferenceJacobians DifferentiateByRichardson(const FunctionAtPoint& at);
GradientCheckerProbe RunGradientChecker(const FunctionAtPoint& at, double relative_precision);

/// The number of tangent directions of a block, and a point moved along them. Throw InputError if
/// the manifold does not fit the block.
int ManifoldTangentSize(const ManifoldSpec& spec, int size);
std::vector<double> ManifoldPlus(const ManifoldSpec& spec, const std::vector<double>& x,
                                 const std::vector<double>& delta);

}  // namespace bundle
