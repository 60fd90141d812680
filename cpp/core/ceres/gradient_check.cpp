#include "core/ceres/gradient_check.h"

#include <bundle/numeric_jacobian.h>
#include <ceres/gradient_checker.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "core/ceres/ceres_graph.h"

namespace bundle {

namespace {

/// A cost function that repeats the residual of its first evaluation at a given point.
/// GradientChecker logs every residual that differs between two calls.
class SameResidual final : public ceres::CostFunction {
 public:
  SameResidual(const ceres::CostFunction& cost, const std::vector<const double*>& point)
      : cost_(cost), point_(point) {
    set_num_residuals(cost.num_residuals());
    *mutable_parameter_block_sizes() = cost.parameter_block_sizes();
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (!cost_.Evaluate(parameters, residuals, jacobians)) return false;
    if (!IsPoint(parameters)) return true;
    if (first_.empty()) first_.assign(residuals, residuals + num_residuals());
    std::copy(first_.begin(), first_.end(), residuals);
    return true;
  }

 private:
  bool IsPoint(double const* const* parameters) const {
    for (size_t b = 0; b < point_.size(); ++b) {
      if (!std::equal(point_[b], point_[b] + parameter_block_sizes()[b], parameters[b])) {
        return false;
      }
    }
    return true;
  }

  const ceres::CostFunction& cost_;
  const std::vector<const double*>& point_;
  mutable std::vector<double> first_;
};

}  // namespace

GradientCheckerProbe RunGradientChecker(const ceres::CostFunction& cost, const Manifolds& manifolds,
                                        const std::vector<const double*>& parameters,
                                        double relative_precision) {
  const SameResidual repeatable(cost, parameters);
  // For the manifolds, a plain nullptr would be ambiguous in Ceres 2.1.
  const ceres::GradientChecker checker(&repeatable, &manifolds, ceres::NumericDiffOptions());
  ceres::GradientChecker::ProbeResults results;
  GradientCheckerProbe probe;
  probe.agrees = checker.Probe(parameters.data(), relative_precision, &results);
  probe.message = std::move(results.error_log);
  if (!results.return_value || results.local_numeric_jacobians.size() != parameters.size()) {
    return probe;
  }
  const auto side_by_side = [&](const auto& blocks) {
    std::vector<double> values;
    for (int row = 0; row < cost.num_residuals(); ++row) {
      for (const auto& block : blocks) {
        for (int j = 0; j < block.cols(); ++j) values.push_back(block(row, j));
      }
    }
    return values;
  };
  probe.local_jacobian = side_by_side(results.local_jacobians);
  probe.local_numeric_jacobian = side_by_side(results.local_numeric_jacobians);
  return probe;
}

namespace {

class FunctionCost final : public ceres::CostFunction {
 public:
  explicit FunctionCost(const FunctionAtPoint& at) : function_(at.function) {
    set_num_residuals(at.num_residuals);
    for (const std::vector<double>& block : at.blocks) {
      mutable_parameter_block_sizes()->push_back(static_cast<int32_t>(block.size()));
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    return function_(parameters, residuals, jacobians);
  }

 private:
  const ResidualFunction& function_;
};

/// The same function as a cost function of Ceres.
struct CostAtPoint {
  explicit CostAtPoint(const FunctionAtPoint& at) : cost(at) {
    for (size_t b = 0; b < at.blocks.size(); ++b) {
      const int size = static_cast<int>(at.blocks[b].size());
      owned.push_back(MakeManifold(at.manifolds[b].name, size, at.manifolds[b].constant));
      manifolds.push_back(owned.back().get());
      parameters.push_back(at.blocks[b].data());
    }
  }

  FunctionCost cost;
  std::vector<std::unique_ptr<ceres::Manifold>> owned;
  Manifolds manifolds;
  std::vector<const double*> parameters;
};

}  // namespace

ReferenceJacobians DifferentiateByRichardson(const FunctionAtPoint& at, const KnownScales& known) {
  const CostAtPoint point(at);
  return DifferentiateByRichardson(point.cost, point.manifolds, point.parameters, known);
}

GradientCheckerProbe RunGradientChecker(const FunctionAtPoint& at, double relative_precision) {
  const CostAtPoint point(at);
  return RunGradientChecker(point.cost, point.manifolds, point.parameters, relative_precision);
}

int ManifoldTangentSize(const ManifoldSpec& spec, int size) {
  const auto manifold = MakeManifold(spec.name, size, spec.constant);
  return manifold == nullptr ? size : manifold->TangentSize();
}

std::vector<double> ManifoldPlus(const ManifoldSpec& spec, const std::vector<double>& x,
                                 const std::vector<double>& delta) {
  std::vector<double> moved = x;
  const auto manifold = MakeManifold(spec.name, static_cast<int>(x.size()), spec.constant);
  if (manifold != nullptr) {
    manifold->Plus(x.data(), delta.data(), moved.data());
  } else {
    for (size_t j = 0; j < x.size(); ++j) moved[j] += delta[j];
  }
  return moved;
}

}  // namespace bundle
