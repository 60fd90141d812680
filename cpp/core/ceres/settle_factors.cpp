#include "core/ceres/settle_factors.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "core/interface/settling.h"
#include "core/model/factor_costs.h"

namespace bundle {
namespace {

/// Continues the numbering of iterations, and ends the solve when the factors have settled.
class WatchFactors final : public ceres::IterationCallback {
 public:
  WatchFactors(const KindCosts& factors, double tolerance,
               const std::vector<ceres::IterationCallback*>& callbacks, const MayEnd& may_end,
               const ceres::IterationSummary& last)
      : factors_(factors),
        tolerance_(tolerance),
        callbacks_(callbacks),
        may_end_(may_end),
        last_(last) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    if (iteration.iteration == 0) {
      costs_ = factors_.ByKind();
      return ceres::SOLVER_CONTINUE;
    }
    const ceres::IterationSummary numbered = After(last_, iteration);
    for (ceres::IterationCallback* callback : callbacks_) {
      const ceres::CallbackReturnType wish = (*callback)(numbered);
      if (wish != ceres::SOLVER_CONTINUE) return wish;
    }
    if (!iteration.step_is_successful) return ceres::SOLVER_CONTINUE;
    const std::vector<double> before = std::exchange(costs_, factors_.ByKind());
    const double total = iteration.cost + iteration.cost_change;
    settled_ = may_end_(
        iteration, std::abs(iteration.cost_change) <= tolerance_ * total &&
                       LargestRelativeChange(before, costs_, factors_.Expected()) <= tolerance_);
    return settled_ ? ceres::SOLVER_TERMINATE_SUCCESSFULLY : ceres::SOLVER_CONTINUE;
  }

  bool settled() const { return settled_; }

  static ceres::IterationSummary After(const ceres::IterationSummary& last,
                                       ceres::IterationSummary iteration) {
    iteration.iteration += last.iteration;
    iteration.cumulative_time_in_seconds += last.cumulative_time_in_seconds;
    return iteration;
  }

 private:
  const KindCosts& factors_;
  const double tolerance_;
  const std::vector<ceres::IterationCallback*>& callbacks_;
  const MayEnd& may_end_;
  const ceres::IterationSummary last_;
  std::vector<double> costs_;
  bool settled_ = false;
};

void Append(const ceres::Solver::Summary& more, ceres::Solver::Summary* summary) {
  const ceres::IterationSummary last = summary->iterations.back();
  for (size_t i = 1; i < more.iterations.size(); ++i) {
    summary->iterations.push_back(WatchFactors::After(last, more.iterations[i]));
  }
  summary->final_cost = more.final_cost;
  summary->num_successful_steps += more.num_successful_steps - 1;  // Ceres counts the start as one
  summary->num_unsuccessful_steps += more.num_unsuccessful_steps;
  summary->preprocessor_time_in_seconds += more.preprocessor_time_in_seconds;
  summary->residual_evaluation_time_in_seconds += more.residual_evaluation_time_in_seconds;
  summary->jacobian_evaluation_time_in_seconds += more.jacobian_evaluation_time_in_seconds;
  summary->linear_solver_time_in_seconds += more.linear_solver_time_in_seconds;
  summary->minimizer_time_in_seconds += more.minimizer_time_in_seconds;
  summary->postprocessor_time_in_seconds += more.postprocessor_time_in_seconds;
  summary->total_time_in_seconds += more.total_time_in_seconds;
  summary->num_residual_evaluations += more.num_residual_evaluations;
  summary->num_jacobian_evaluations += more.num_jacobian_evaluations;
  summary->num_linear_solves += more.num_linear_solves;
}

}  // namespace

void KindCosts::Add(uint32_t kind, const ceres::CostFunction& cost, const ceres::LossFunction* loss,
                    const std::vector<double*>& blocks) {
  factors_.push_back({kind, &cost, loss, blocks});
}

std::vector<double> KindCosts::ByKind() const {
  std::map<uint32_t, double> costs;
  std::vector<double> residual;
  for (const One& one : factors_) {
    residual.resize(one.cost->num_residuals());
    if (!one.cost->Evaluate(one.blocks.data(), residual.data(), nullptr)) continue;
    double rho[3] = {0, 1, 0};
    for (const double r : residual) rho[0] += r * r;
    if (one.loss != nullptr) one.loss->Evaluate(rho[0], rho);
    costs[one.kind] += rho[0] / 2;
  }
  std::vector<double> result;
  for (const auto& [kind, cost] : costs) result.push_back(cost);
  return result;
}

std::vector<double> KindCosts::Expected() const {
  std::map<uint32_t, double> costs;
  for (const One& one : factors_) costs[one.kind] += 0.5 * one.cost->num_residuals();
  std::vector<double> result;
  for (const auto& [kind, cost] : costs) result.push_back(cost);
  return result;
}

bool EndedByTolerance(const ceres::Solver::Summary& summary) {
  return summary.termination_type == ceres::CONVERGENCE &&
         (summary.message.rfind("Function tolerance", 0) == 0 ||
          summary.message.rfind("Parameter tolerance", 0) == 0);
}

bool SettleFactors(const KindCosts& factors, ceres::Solver::Options options,
                   const std::vector<ceres::IterationCallback*>& callbacks, const MayEnd& may_end,
                   ceres::Problem* problem, ceres::Solver::Summary* summary) {
  const ceres::IterationSummary& last = summary->iterations.back();
  const double tolerance = options.function_tolerance;
  if (!(tolerance > kTightTolerance)) return false;
  options.max_num_iterations -= last.iteration;
  options.function_tolerance = kLostChange;
  options.initial_trust_region_radius = last.trust_region_radius;
  if (options.trust_region_strategy_type == ceres::LEVENBERG_MARQUARDT) {
    options.initial_trust_region_radius = std::max(last.trust_region_radius, kWideRadius);
  }
  WatchFactors watch(factors, tolerance, callbacks, may_end, last);
  options.callbacks = {&watch};
  ceres::Solver::Summary more;
  ceres::Solve(options, problem, &more);
  if (!more.IsSolutionUsable() || more.iterations.empty()) return false;
  if (more.termination_type != ceres::CONVERGENCE && !watch.settled()) {
    summary->termination_type = more.termination_type;
    summary->message = more.message;
  }
  Append(more, summary);
  return true;
}

}  // namespace bundle
