#include "core/pose_graph/gauss_newton_trial.h"

/// Gauss-Newton steps of a pose graph often raise the cost once before they lower it: a first step
/// turns the poses and stretches the paths between them, the next one shortens the paths. A trust
/// region that rejects the first step must shrink from "no damping" to the curvature of the graph,
/// and then follows a narrow valley in small steps: 22 systems on the set MIT instead of 7.
///
/// Therefore a rejected step at a radius without effect is the first of a trial: a few plain
/// Gauss-Newton steps, whatever their cost, until one ends below the cost before the trial. The
/// solve continues from there. Without such a step it returns to the state before the trial, with a
/// radius whose damping has an effect. Either way the cost of a solve never rises (the watchdog
/// technique: Chamberlain, Powell, Lemarechal, Pedersen, Mathematical Programming Study 16, 1982;
/// Nocedal, Wright: Numerical Optimization, 2nd ed., section 15.6).
///
/// Steps of a trial count as rejected if their cost is not below that before the trial.

#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace bundle {
namespace {

/// Damping 1 / R of a smaller part of the diagonal does not change a step.
constexpr double kRadiusWithoutEffect = 1e12;
/// The first radius after a trial that failed, and after the last trial.
constexpr double kRadiusAfterTrial = 1e6;
constexpr int kStepsOfTrial = 5;
constexpr int kMostTrials = 4;
/// The largest cost after a trial, relative to the one before: lower by more than rounding.
constexpr double kLower = 1 - 1e-6;

/// Counts the steps of a trial, from record `begin` to the first one below `cost`, as rejected if
/// they are not below it.
void CountRejected(double cost, size_t begin, MinimizerSummary* minimum) {
  for (size_t k = begin; k < minimum->iterations.size(); ++k) {
    IterationRecord& record = minimum->iterations[k];
    if (!record.step_is_successful) continue;
    record.cost_change = cost - record.cost;
    if (record.cost < kLower * cost) return;
    record.step_is_successful = false;
    --minimum->num_successful_steps;
    ++minimum->num_unsuccessful_steps;
  }
}

/// Minimises until the user stops it, or `ends` does, which sets `has_ended`.
template <typename Ends>
MinimizerSummary MinimizeUntil(const SolveOptions& options, const ProgressCallback& progress,
                               PoseGraphProblem* problem, MinimizerSummary before, bool* has_ended,
                               const Ends& ends) {
  *has_ended = false;
  const ProgressCallback watch = [&](const IterationRecord& record) {
    if (progress && !progress(record)) return false;
    *has_ended = ends(record);
    return !*has_ended;
  };
  MinimizerSummary minimum = Minimize(options, watch, problem, std::move(before));
  if (*has_ended) minimum.interrupted = false;
  return minimum;
}

}  // namespace

MinimizerSummary MinimizePoseGraph(const SolveOptions& options, const ProgressCallback& progress,
                                   PoseGraphProblem* problem) {
  const bool is_gauss_newton =
      options.trust_region_strategy_type == TrustRegionStrategy::kLevenbergMarquardt &&
      options.initial_trust_region_radius >= kRadiusWithoutEffect;
  if (!is_gauss_newton) return Minimize(options, progress, problem);

  SolveOptions now = options;  // a trial that succeeds goes on with those of the solve
  double cost = 0;
  bool is_trial = false, is_rejected = false;
  const auto is_to_be_tried = [&](const IterationRecord& record) {
    if (is_trial && !(record.cost < kLower * cost)) return false;
    if (is_trial) now = options;
    is_trial = false;
    if (record.step_is_successful) cost = record.cost;
    return !record.step_is_successful && record.trust_region_radius >= kRadiusWithoutEffect &&
           record.iteration + kStepsOfTrial < options.max_num_iterations;
  };
  MinimizerSummary minimum =
      MinimizeUntil(now, progress, problem, {}, &is_rejected, is_to_be_tried);
  for (int count = 0; is_rejected && count < kMostTrials; ++count) {
    const std::vector<double> before = problem->poses();
    const double cost_before = cost;
    const size_t begin = minimum.iterations.size();
    const IterationRecord& rejected = minimum.iterations.back();
    now.min_relative_decrease = std::numeric_limits<double>::lowest();
    now.max_num_iterations = rejected.iteration + kStepsOfTrial;
    if (rejected.step_norm > 0) problem->Accept();  // an invalid step has no candidate
    is_trial = true;
    minimum =
        MinimizeUntil(now, progress, problem, std::move(minimum), &is_rejected, is_to_be_tried);
    CountRejected(cost_before, begin, &minimum);
    if (!is_trial) continue;
    problem->Restore(before);
    if (minimum.interrupted) return minimum;
    is_rejected = true;
    break;
  }
  if (!is_rejected) return minimum;
  SolveOptions rest = options;
  rest.initial_trust_region_radius = kRadiusAfterTrial;
  return Minimize(rest, progress, problem, std::move(minimum));
}

}  // namespace bundle
