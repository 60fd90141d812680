#include "core/ceres/function_check.h"

#include <memory>

#include "core/ceres/gradient_check.h"
#include "core/ceres/manifolds.h"

namespace bundle {
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

/// The same in Ceres' terms.
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

ReferenceJacobians DifferentiateByRichardson(const FunctionAtPoint& at) {
  const CostAtPoint point(at);
  return DifferentiateByRichardson(point.cost, point.manifolds, point.parameters);
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
