#include "core/ceres/solve_graph.h"

#include <algorithm>
#include <limits>
#include <string>
#include <utility>

#include "core/ceres/ceres_graph.h"
#include "core/ceres/summarize.h"
#include "core/ceres/translate_options.h"
#include "core/ceres/untaken_decrease.h"
#include "core/checking/check_solution.h"
#include "core/error.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/memory.h"
#include "core/words.h"

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
  if (!done)
    throw InputError(
        "factor graph: expected finite residuals and Jacobians, found a factor without");
  result.block_begin.push_back(0);
  for (const Block& block : graph.blocks) {
    result.block_begin.push_back(result.block_begin.back() + block.retraction.tangent_size());
  }
  result.row_begin.assign(jacobian.rows.begin(), jacobian.rows.end());
  result.columns = std::move(jacobian.cols);
  result.values = std::move(jacobian.values);
  return result;
}

namespace {

/// Up to these numbers of columns and entries of a dense Jacobian, the dense normal equations are
/// faster than any sparse method.
constexpr int kMostDenseColumns = 100;
constexpr double kMostDenseEntries = 1e6;

/// Stores the values of the last accepted step. Ceres restores the start if it fails, also if a
/// Jacobian cannot be evaluated because the user ended the solve.
class KeepBestState final : public ceres::IterationCallback {
 public:
  explicit KeepBestState(const CeresGraph& graph) : graph_(graph), values_(graph.values()) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    if (iteration.step_is_successful) values_ = graph_.values();
    return ceres::SOLVER_CONTINUE;
  }

  const std::vector<std::vector<double>>& values() const { return values_; }

 private:
  const CeresGraph& graph_;
  std::vector<std::vector<double>> values_;
};

struct Shape {
  int num_columns = 0;
  int num_rows = 0;
  bool has_bounds = false;
};

Shape ShapeOf(const FactorGraph& graph) {
  Shape shape;
  for (const Block& block : graph.blocks) {
    shape.num_columns += block.NumFree();
    shape.has_bounds = shape.has_bounds || !block.lower.empty();
  }
  for (const auto& factor : graph.factors) shape.num_rows += factor->num_residuals();
  return shape;
}

bool IsDense(LinearSolverType type) {
  return type == LinearSolverType::kDenseNormalCholesky || type == LinearSolverType::kDenseQr ||
         type == LinearSolverType::kDenseSchur;
}

/// In a graph, DENSE_SCHUR may find few blocks to eliminate: it is counted like the normal
/// equations.
double DenseBytes(LinearSolverType type, const ProblemShape& shape) {
  const bool is_qr = type == LinearSolverType::kDenseQr;
  return PredictDenseMatrixBytes(is_qr ? type : LinearSolverType::kDenseNormalCholesky, shape,
                                 /*cameras_eliminated=*/false);
}

/// Replaces kAuto, and returns the reason for the choice.
std::string Choose(const Shape& shape, SolveOptions* options) {
  if (options->linear_solver_type != LinearSolverType::kAuto) return "";
  const double entries = static_cast<double>(shape.num_rows) * shape.num_columns;
  const bool dense = shape.num_columns <= kMostDenseColumns && entries <= kMostDenseEntries;
  options->linear_solver_type =
      dense ? LinearSolverType::kDenseNormalCholesky : LinearSolverType::kSparseNormalCholesky;
  const std::string size = Counted(shape.num_rows, "residual") + " of " +
                           Counted(shape.num_columns, "free coordinate") + ": ";
  return size + (dense ? "few enough for dense matrices." : "too many for dense matrices.");
}

ceres::Solver::Options Translate(const Shape& shape, const SolveOptions& options) {
  if (options.backend == Backend::kFused) {
    throw InputError("backend: expected auto or ceres for a factor graph, found fused");
  }
  if (shape.has_bounds &&
      options.trust_region_strategy_type != TrustRegionStrategy::kLevenbergMarquardt) {
    throw InputError(
        "trust_region_strategy_type: expected levenberg_marquardt with bounds, found a dogleg");
  }
  if (IsDense(options.linear_solver_type)) {
    ProblemShape matrices;
    matrices.num_residuals = shape.num_rows;
    matrices.num_camera_columns = shape.num_columns;
    RefuseTooMuchMemory(options.linear_solver_type,
                        DenseBytes(options.linear_solver_type, matrices), "dense matrices",
                        "sparse_normal_cholesky");
  }
  return TranslateOptions(options);
}

}  // namespace

GraphOutput SolveGraph(const FactorGraph& graph, const SolveOptions& given,
                       const ProgressCallback& progress) {
  const Stopwatch time;
  ValidateGraph(graph);
  ThrowIfInterrupted();
  const Shape shape = ShapeOf(graph);
  SolveOptions options = given;
  std::string choice = Choose(shape, &options);
  ceres::Solver::Options ceres_options = Translate(shape, options);
  CeresGraph adapted(graph, /*all_free=*/false);
  const bool one_thread = options.deterministic || !adapted.IsThreadSafe();
  ceres_options.num_threads = one_thread ? 1 : CountStartableThreads(ceres_options.num_threads);
  ceres_options.update_state_every_iteration = true;
  KeepBestState best(adapted);
  ceres_options.callbacks.push_back(&best);
  ceres_options.callbacks.push_back(&adapted.step_lengths());
  ReportProgress report(progress, 0, adapted.step_lengths(), adapted.abandoned());
  ceres_options.callbacks.push_back(&report);

  const bool large =
      IsDense(options.linear_solver_type) && shape.num_columns >= kColumnsWorthBlasThreads;
  const ProcessSettings settings(large ? ceres_options.num_threads : 1);
  const Stopwatch solve_time;
  ceres::Solver::Summary summary;
  ceres::Solve(ceres_options, &adapted.problem(), &summary);
  adapted.RethrowFactorException();
  const bool abandoned = adapted.abandoned();
  if (abandoned && summary.iterations.empty()) throw Interrupted();
  if (abandoned) ForgetAbandonedStep(&summary);

  GraphOutput output;
  output.solve_time_in_seconds = solve_time.seconds();
  output.values = abandoned ? best.values() : adapted.values();
  output.summary = Summarize(summary, 0);
  output.summary.interrupted = abandoned || report.interrupted();
  output.summary.backend_given = UpperName(given.backend, kBackends);
  output.summary.backend_used = UpperName(Backend::kCeres, kBackends);
  if (given.backend == Backend::kAuto) {
    output.summary.backend_choice = "Factor graphs are solved by Ceres.";
  }
  output.summary.linear_solver_choice = std::move(choice);
  output.summary.num_information_nonzeros = adapted.CountInformationNonzeros();
  output.summary.warnings = FindFallbacks(summary);
  for (const ceres::IterationSummary& iteration : summary.iterations) {
    output.iterations.push_back(ToRecord(iteration, 0, adapted.step_lengths()));
  }
  output.summary.untaken_decrease = UntakenDecrease(summary, &adapted.problem());
  JudgeEnd(shape.has_bounds, options.function_tolerance, &output);
  output.build_time_in_seconds = time.seconds() - output.solve_time_in_seconds;
  return output;
}

}  // namespace bundle
