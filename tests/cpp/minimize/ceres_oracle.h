#pragma once

/// ceres::Solve with DENSE_QR on a ClassicFunction.

#include <ceres/ceres.h>

#include <Eigen/Core>
#include <algorithm>
#include <vector>

#include "core/ceres/translate_options.h"
#include "core/interface/options.h"
#include "minimize/classic_functions.h"

namespace bundle {

class CeresFunction final : public ceres::CostFunction {
 public:
  explicit CeresFunction(const ClassicFunction& function) : function_(function) {
    set_num_residuals(function.num_residuals);
    mutable_parameter_block_sizes()->push_back(static_cast<int>(function.start.size()));
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const int num_parameters = parameter_block_sizes()[0];
    Eigen::VectorXd r(num_residuals());
    Eigen::MatrixXd j(num_residuals(), num_parameters);
    function_.evaluate(Eigen::Map<const Eigen::VectorXd>(parameters[0], num_parameters), &r, &j);
    std::copy(r.begin(), r.end(), residuals);
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    for (int i = 0; i < num_residuals(); ++i) {
      for (int k = 0; k < num_parameters; ++k) jacobians[0][i * num_parameters + k] = j(i, k);
    }
    return true;
  }

 private:
  const ClassicFunction& function_;
};

struct CeresResult {
  ceres::Solver::Summary summary;
  std::vector<double> x;
};

inline CeresResult SolveWithCeres(const ClassicFunction& function, const SolveOptions& options) {
  CeresResult result;
  result.x = function.start;
  ceres::Problem problem;
  problem.AddResidualBlock(new CeresFunction(function), nullptr, result.x.data());
  for (size_t k = 0; k < function.lower.size(); ++k) {
    problem.SetParameterLowerBound(result.x.data(), static_cast<int>(k), function.lower[k]);
    problem.SetParameterUpperBound(result.x.data(), static_cast<int>(k), function.upper[k]);
  }
  ceres::Solver::Options ceres_options;
  ceres_options.linear_solver_type = ceres::DENSE_QR;
  ceres_options.logging_type = ceres::SILENT;
  ceres_options.max_num_consecutive_invalid_steps = 10;
  ceres_options.max_num_iterations = options.max_num_iterations;
  ceres_options.function_tolerance = options.function_tolerance;
  ceres_options.gradient_tolerance = options.gradient_tolerance;
  ceres_options.parameter_tolerance = options.parameter_tolerance;
  if (options.trust_region_strategy_type != TrustRegionStrategy::kLevenbergMarquardt) {
    ceres_options.trust_region_strategy_type = ceres::DOGLEG;
  }
  if (options.trust_region_strategy_type == TrustRegionStrategy::kSubspaceDogleg) {
    ceres_options.dogleg_type = ceres::SUBSPACE_DOGLEG;
  }
  const ProcessSettings quiet(1);
  ceres::Solve(ceres_options, &problem, &result.summary);
  return result;
}

}  // namespace bundle
