#include "core/ceres/linearize_graph.h"

#include <utility>

#include "core/ceres/factor_adapter.h"
#include "core/ceres/process_settings.h"
#include "core/error.h"
#include "core/interruption.h"
#include "core/parallel_for.h"

namespace bundle {

LinearizedGraph LinearizeGraph(const FactorGraph& graph, int num_threads) {
  CeresGraph adapted(graph, /*all_free=*/true);
  ceres::Problem::EvaluateOptions options;
  options.num_threads = adapted.IsThreadSafe() ? EffectiveNumThreads(num_threads) : 1;
  for (const auto& value : adapted.values()) {
    options.parameter_blocks.push_back(const_cast<double*>(value.data()));
  }
  LinearizedGraph result;
  ceres::CRSMatrix jacobian;
  const ProcessSettings settings(1);
  const bool done =
      adapted.problem().Evaluate(options, &result.cost, &result.residual, nullptr, &jacobian);
  adapted.RethrowFactorException();
  if (adapted.abandoned()) throw Interrupted();
  if (!done) throw InputError("factor graph: a factor has no value, or no finite one");
  result.block_begin.push_back(0);
  for (const Block& block : graph.blocks) {
    result.block_begin.push_back(result.block_begin.back() + block.retraction.tangent_size());
  }
  result.row_begin.assign(jacobian.rows.begin(), jacobian.rows.end());
  result.columns = std::move(jacobian.cols);
  result.values = std::move(jacobian.values);
  return result;
}

}  // namespace bundle
