#include "core/ceres/untaken_decrease.h"

/// The remaining decrease if Ceres ended by its parameter tolerance. Ceres keeps no record of this
/// last step.
///
/// With the gradient g and G = J^T J, the minimum of the linearised cost is lower by 1/2 g^T G^-1
/// g. This is at least 1/2 g_j^2 / G_jj for any single coordinate j. Only the blocks with the
/// largest gradients are evaluated, so that no second full Jacobian is needed.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <string>
#include <utility>
#include <vector>

namespace bundle {
namespace {

constexpr size_t kBlocks = 16;

double LargestOf(const double* values, int count) {
  double largest = 0;
  for (int j = 0; j < count; ++j) largest = std::max(largest, std::abs(values[j]));
  return largest;
}

std::vector<double*> BlocksWithLargestGradients(ceres::Problem* problem) {
  ceres::Problem::EvaluateOptions options;
  std::vector<double*> all;
  problem->GetParameterBlocks(&all);
  std::copy_if(all.begin(), all.end(), std::back_inserter(options.parameter_blocks),
               [&](double* block) { return !problem->IsParameterBlockConstant(block); });
  std::vector<double> gradient;
  if (!problem->Evaluate(options, nullptr, nullptr, &gradient, nullptr)) return {};
  std::vector<std::pair<double, double*>> blocks;
  const double* next = gradient.data();
  for (double* const block : options.parameter_blocks) {
    const int size = problem->ParameterBlockTangentSize(block);
    blocks.emplace_back(LargestOf(next, size), block);
    next += size;
  }
  const size_t count = std::min(kBlocks, blocks.size());
  std::partial_sort(blocks.begin(), blocks.begin() + static_cast<std::ptrdiff_t>(count),
                    blocks.end(), [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<double*> largest;
  for (size_t i = 0; i < count; ++i) largest.push_back(blocks[i].second);
  return largest;
}

}  // namespace

double UntakenDecrease(const ceres::Solver::Summary& summary, ceres::Problem* problem) {
  const bool by_parameters = summary.termination_type == ceres::CONVERGENCE &&
                             summary.message.rfind("Parameter tolerance", 0) == 0;
  if (!by_parameters || !summary.iterations.back().step_is_successful) return 0;
  ceres::Problem::EvaluateOptions options;
  options.parameter_blocks = BlocksWithLargestGradients(problem);
  std::vector<double> gradient;
  ceres::CRSMatrix jacobian;
  if (options.parameter_blocks.empty() ||
      !problem->Evaluate(options, nullptr, nullptr, &gradient, &jacobian)) {
    return 0;
  }
  std::vector<double> squared(jacobian.num_cols);
  for (size_t e = 0; e < jacobian.values.size(); ++e) {
    squared[jacobian.cols[e]] += jacobian.values[e] * jacobian.values[e];
  }
  double decrease = 0;
  for (int j = 0; j < jacobian.num_cols; ++j) {
    if (squared[j] > 0) decrease = std::max(decrease, 0.5 * gradient[j] * gradient[j] / squared[j]);
  }
  return decrease;
}

}  // namespace bundle
