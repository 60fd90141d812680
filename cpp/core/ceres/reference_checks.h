#pragma once

/// Ceres as a reference, declared without its headers: robust losses, Jacobians of any residual
/// function, and the reprojection residuals of a problem.

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/factors/loss.h"
#include "core/factors/reprojection.h"
#include "core/interface/adjustment_problem.h"

namespace bundle {

/// rho, rho', rho'' at each of `count` squared norms >= 0; `values` is count x 3.
void EvaluateLoss(LossType type, double scale, int64_t count, const double* squared_norms,
                  double* values);

/// What Ceres makes of a residual block under a loss: r (rows) and J (rows x columns, row-major)
/// are overwritten by those that the solver sees, given rho, rho', rho'' at ||r||^2. rho' must be
/// positive where rho'' is.
void CorrectWithCeres(const double* rho, int rows, int columns, double* residual, double* jacobian);

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
/// the cost function has no value at one of the points it needs.
struct GradientCheckerProbe {
  bool agrees = false;  ///< its own verdict at the given relative precision
  std::vector<double> local_jacobian;
  std::vector<double> local_numeric_jacobian;
  std::string message;  ///< its error_log
};

/// A residual, as ceres::CostFunction::Evaluate: Jacobians row-major, `jacobians` or single ones
/// may be nullptr; false where there is no value.
using ResidualFunction =
    std::function<bool(double const* const* parameters, double* residuals, double** jacobians)>;

/// What MakeManifold (factor_adapter.h) takes.
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

/// Where the Jacobians of checked observations go: num_checked x 2 x columns, row-major, columns
/// (w, t) of the pose, the camera's parameters (camera_params_stride), the point. What the model
/// does not have or never refines stays zero.
struct ReprojectionCheck {
  double* analytic = nullptr;     ///< by the cost function that a solve uses
  double* reference = nullptr;    ///< by Richardson extrapolation
  double* uncertainty = nullptr;  ///< of the reference
  double* ceres = nullptr;        ///< by ceres::GradientChecker; not a number where it gave up
  double* rounding = nullptr;     ///< num_checked: delta / L
  uint8_t* counts = nullptr;      ///< num_checked: 0 for an observation that contributes nothing
  uint8_t* agrees = nullptr;      ///< num_checked: GradientChecker's own verdict
  uint8_t* stable = nullptr;  ///< num_checked: the residual is the same with and without Jacobians
};

/// Checks the observations of these indices, each at its image's pose, which is written as Exp(w)
/// R0 with w = offsets (num_checked x 3): the Jacobian is tried away from the start of its chart.
///
/// Throws InputError, naming model and image, if an observed image has an unknown camera model.
void CheckReprojections(const AdjustmentProblem& problem, const int64_t* observations,
                        int64_t num_checked, const double* offsets, Cheirality cheirality,
                        double relative_precision, int num_threads, const ReprojectionCheck& out);

}  // namespace bundle
