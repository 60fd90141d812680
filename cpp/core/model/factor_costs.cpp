#include "core/model/factor_costs.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <typeinfo>
#include <vector>

#include "core/factors/loss.h"
#include "core/geometry/rotation.h"
#include "core/model/problem_factors.h"

namespace bundle {
namespace {

constexpr double kLeastExpectation = 50;

}  // namespace

double ApplyLoss(const Factor& factor, int columns, double* residual, double* jacobian) {
  const int rows = factor.num_residuals();
  const double squared_norm = SquaredNorm(residual, rows);
  double rho[3];
  ValueOfLoss(factor.loss(), factor.loss_scale(), squared_norm, rho);
  if (jacobian != nullptr && factor.loss() != LossType::kTrivial) {
    // The correction exists: every loss has rho'' <= 0.
    const auto correction = SolveTriggs(rho, squared_norm, SecondOrderTerm::kClamped);
    ApplyTriggs(*correction, rows, columns, residual, jacobian);
  }
  return 0.5 * rho[0];
}

uint32_t KindOf(const Factor& factor, const AdjustmentProblem& problem) {
  std::string key = typeid(factor).name() + std::to_string(factor.num_residuals());
  for (const int block : factor.blocks()) {
    key += static_cast<char>('a' + static_cast<int>(problem.factors->variables[block].kind));
  }
  uint32_t hash = 2166136261U;  // FNV-1a hash (Fowler, Noll, Vo)
  for (const char letter : key) hash = (hash ^ static_cast<unsigned char>(letter)) * 16777619U;
  return hash;
}

double LargestRelativeChange(const std::vector<double>& before, const std::vector<double>& after,
                             const std::vector<double>& expected) {
  double largest = 0;
  for (size_t k = 0; k < before.size(); ++k) {
    const double change = std::abs(after[k] - before[k]);
    const double cost = std::max({before[k], after[k], expected[k], kLeastExpectation});
    if (change > 0) largest = std::max(largest, change / cost);
  }
  return largest;
}

std::vector<double> FactorCosts(const AdjustmentProblem& problem) {
  constexpr int kNumbers = 7;  // of a pose
  std::vector<double> costs;
  if (problem.factors == nullptr) return costs;
  for (const auto& factor : problem.factors->factors) {
    std::vector<const double*> values;
    std::vector<double> poses(kNumbers * factor->blocks().size());
    for (size_t v = 0; v < factor->blocks().size(); ++v) {
      const ProblemVariable& variable = problem.factors->variables[factor->blocks()[v]];
      values.push_back(ValueOf(variable, problem));
      if (factor->retractions()[v].manifold() == Manifold::kEuclidean) continue;
      double* const pose = poses.data() + kNumbers * v;
      std::copy_n(values.back(), kNumbers, pose);
      NormalizeQuaternion(pose);
      values.back() = pose;
    }
    std::vector<double> residual(factor->num_residuals());
    const bool has_value = factor->Evaluate(values.data(), residual.data(), nullptr);
    costs.push_back(has_value ? ApplyLoss(*factor, 0, residual.data(), nullptr)
                              : std::numeric_limits<double>::quiet_NaN());
  }
  return costs;
}

}  // namespace bundle
