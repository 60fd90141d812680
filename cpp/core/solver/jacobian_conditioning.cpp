#include "core/solver/jacobian_conditioning.h"

#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/solver/block_qr.h"
#include "core/solver/graph_jacobian.h"

namespace bundle {
namespace {

using Eigen::VectorXd;

/// Estimates the largest eigenvalue of `multiply` by power iteration from a fixed start.
template <typename Multiply>
double LargestEigenvalue(int n, const Multiply& multiply) {
  constexpr int kMaxSteps = 60;
  VectorXd x(n);
  for (int i = 0; i < n; ++i) x[i] = 1 + 0.5 * std::sin(1.7 * i + 0.3);
  x.normalize();
  double value = 0;
  for (int k = 0; k < kMaxSteps; ++k) {
    x = multiply(x);
    const double norm = x.norm();
    if (!(norm > 0) || !std::isfinite(norm)) return norm;
    x /= norm;
    const bool is_settled = std::abs(norm - value) <= 1e-3 * norm;
    value = norm;
    if (is_settled && k > 3) break;
  }
  return value;
}

}  // namespace

JacobianConditioning EstimateConditioning(const FactorGraph& graph) {
  ValidateGraph(graph);
  const GraphJacobian evaluation(graph);
  const int n = evaluation.num_columns();
  if (n == 0) throw InputError("factor graph: expected free coordinates, found 0");
  GraphJacobian::Values values;
  for (const Block& block : graph.blocks) values.push_back(block.value);
  VectorXd residual;
  GraphJacobian::Sparse jacobian;
  if (!std::isfinite(evaluation.Evaluate(values, &residual, &jacobian))) {
    throw InputError(
        "factor graph: expected finite residuals and Jacobians, found a factor without");
  }
  VectorXd scale(n);
  for (int c = 0; c < n; ++c) {
    const double norm = jacobian.col(c).norm();
    scale[c] = norm > 0 ? 1 / norm : 1;
  }
  std::vector<RowBlock> rows = evaluation.Rows(jacobian, residual, scale);
  BlockQr qr(evaluation.sizes(), rows);
  qr.Factorize(std::move(rows));
  jacobian = jacobian * scale.asDiagonal();
  JacobianConditioning result;
  result.num_columns = n;
  const double rounding = 16 * n * std::numeric_limits<double>::epsilon();
  const VectorXd pivots = qr.Pivots();
  const std::vector<int> sizes = evaluation.sizes();
  int column = 0;
  for (size_t v = 0; v < sizes.size(); ++v) {
    for (int c = 0; c < sizes[v]; ++c) {
      if (!(pivots[column++] > rounding)) result.dependent.push_back(static_cast<int>(v));
    }
  }
  result.max_singular_value = std::sqrt(LargestEigenvalue(
      n, [&](const VectorXd& x) { return VectorXd(jacobian.transpose() * (jacobian * x)); }));
  if (!result.dependent.empty()) return result;
  const double inverse = LargestEigenvalue(n, [&](const VectorXd& x) { return qr.SolveNormal(x); });
  result.min_singular_value = std::isfinite(inverse) && inverse > 0 ? 1 / std::sqrt(inverse) : 0;
  return result;
}

}  // namespace bundle
