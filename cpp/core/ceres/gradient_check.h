#pragma once

/// Two references for the Jacobians of one residual function at one point.
///
/// The first is ceres::GradientChecker, which users know. It differentiates along the tangent space
/// of the manifolds, so that errors along their normals stay hidden. Its step is 1e-2 (or 1e-2 of
/// the parameter), which it reduces at most a thousandfold. If one side is exactly zero, it
/// compares absolutely. The check returns its derivatives and only counts its verdicts.
///
/// The second reference is Richardson extrapolation (bundle/numeric_jacobian.h). It differentiates
/// in the ambient space, parameter by parameter, and along the manifolds' Plus, without their
/// PlusJacobian. It bounds its own error.

#include <bundle/check_types.h>

#include <functional>
#include <string>
#include <vector>

#include "core/geometry/retraction.h"

namespace ceres {
class CostFunction;
class Manifold;
}  // namespace ceres

namespace bundle {

/// Result of ceres::GradientChecker. Matrices are num_residuals x tangent columns, row-major; empty
/// if the cost function has no value at one of the points that it needs.
struct GradientCheckerProbe {
  bool agrees = false;  ///< GradientChecker's verdict at the given relative precision
  std::vector<double> local_jacobian;
  std::vector<double> local_numeric_jacobian;
  std::string message;  ///< its error_log
};

/// A residual function like ceres::CostFunction::Evaluate: Jacobians are row-major; `jacobians` or
/// single Jacobians may be nullptr. Returns false if there is no value.
using ResidualFunction =
    std::function<bool(double const* const* parameters, double* residuals, double** jacobians)>;

/// Arguments of MakeManifold (ceres_graph.h).
struct ManifoldSpec {
  std::string name;
  std::vector<int> constant;
};

/// A function at a point of its parameters.
struct FunctionAtPoint {
  ResidualFunction function;
  int num_residuals = 0;
  std::vector<std::vector<double>> blocks;
  std::vector<ManifoldSpec> manifolds;  ///< one per block
};

/// Both functions throw InputError if a manifold does not fit its block.
ReferenceJacobians DifferentiateByRichardson(const FunctionAtPoint& at,
                                             const KnownScales& known = {});
GradientCheckerProbe RunGradientChecker(const FunctionAtPoint& at, double relative_precision);

/// The number of tangent directions of a block, and a point moved along them. Both throw InputError
/// if the manifold does not fit the block.
int ManifoldTangentSize(const ManifoldSpec& spec, int size);
std::vector<double> ManifoldPlus(const ManifoldSpec& spec, const std::vector<double>& x,
                                 const std::vector<double>& delta);

/// Manifolds of a cost function's blocks, one per block; nullptr: Euclidean.
using Manifolds = std::vector<const ceres::Manifold*>;

GradientCheckerProbe RunGradientChecker(const ceres::CostFunction& cost, const Manifolds& manifolds,
                                        const std::vector<const double*>& parameters,
                                        double relative_precision);

}  // namespace bundle
