#include "core/minimize/trust_region.h"

/// The outer loop of a trust region method: a step that lowers the cost by more than a thousandth
/// of the predicted decrease is taken; any other step shrinks the trust region. The order of all
/// operations is that of ceres::internal::TrustRegionMinimizer, for monotonic steps. So are the
/// conventions:
///
/// * The start is iteration 0 and counts as a successful step.
/// * Parameter and function tolerance are tested before a step is taken: a step that meets them is
/// not taken and has no record. So does one that ends in an error.
/// * Parameter tolerance is not tested until a step has succeeded.
/// * A cost that is held counts in decreases alone (least_squares.h); costs of records are without.
/// * The record of a rejected step has the candidate's cost, its change, and the gradient at x; a
///   candidate whose cost is not finite costs DBL_MAX. The record of an invalid step has the cost
///   at x, and zeros. The radius in a record is that of the next step.
///
/// Differences from Ceres: factors other than observations settle (interface/settling.h), and those
/// of minimize/solve_end.h.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>
#include <memory>
#include <utility>

#include "core/error.h"
#include "core/interface/settling.h"
#include "core/minimize/make_strategy.h"
#include "core/minimize/projected_line_search.h"
#include "core/minimize/solve_end.h"
#include "core/minimize/strategy.h"
#include "core/minimize/timed_problem.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

constexpr double kNoCost = std::numeric_limits<double>::max();

using Clock = std::chrono::steady_clock;

double SecondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// The nearest multiple of a power of two that is at least `spacing`, but at most 1/8.
double RoundTo(double spacing, double value) {
  if (spacing == 0 || !(std::abs(value) < 1e6)) return value;
  int exponent = 0;
  std::frexp(spacing, &exponent);
  const double unit = std::ldexp(1.0, std::min(exponent, -3));
  return unit * std::round(value / unit);
}

/// "VALUE <= BOUND", as in Ceres' messages.
std::string AtMost(double value, double bound) {
  char text[64];
  std::snprintf(text, sizeof(text), "%e <= %e", value, bound);
  return text;
}

class TrustRegion {
 public:
  TrustRegion(const SolveOptions& options, const ProgressCallback& progress, LeastSquares* problem,
              MinimizerSummary before)
      : options_(options),
        progress_(progress),
        minimum_(std::move(before)),
        problem_(problem, &minimum_),
        strategy_(MakeStrategy(options)),
        end_(problem->DegreesOfFreedom(), &problem_, &minimum_) {}

  MinimizerSummary Run() {
    bool has_iteration = IterationZero();
    while (has_iteration && FinishIteration()) has_iteration = Iterate();
    end_.Finish(x_.cost);
    return std::move(minimum_);
  }

 private:
  struct Costs {
    double cost = 0, held = 0;
  };

  bool IterationZero() {
    if (!minimum_.iterations.empty()) {
      const IterationRecord& last = minimum_.iterations.back();
      seconds_before_ = last.cumulative_time_in_seconds;
      record_.iteration = last.iteration + 1;
      record_.changes_what_counts = true;
      minimum_.untaken_decrease = 0;
    }
    try {
      if (!LinearizeAtX()) {
        return Terminate("FAILURE", "Initial residual and Jacobian evaluation failed.");
      }
    } catch (const Interrupted&) {
      if (minimum_.iterations.empty()) throw;  // no state was evaluated
      minimum_.interrupted = true;
      return TerminateByUser();
    }
    current_ = x_;
    record_.step_is_successful = true;
    end_.JudgeState(record_);
    return true;
  }

  /// Records the iteration; true if another one follows.
  bool FinishIteration() {
    ++(record_.step_is_successful ? minimum_.num_successful_steps
                                  : minimum_.num_unsuccessful_steps);
    record_.trust_region_radius = strategy_->Radius();
    record_.iteration_time_in_seconds = SecondsSince(iteration_start_);
    record_.cumulative_time_in_seconds = seconds_before_ + SecondsSince(start_);
    minimum_.iterations.push_back(record_);
    return !StoppedByUser() && !(may_end_ && ConvergeByFunctionTolerance()) &&
           !MaxNumIterationsReached() && !GradientToleranceReached() && !MinRadiusReached();
  }

  /// Tests a step; true if there is an iteration to record.
  bool Iterate() {
    try {
      return TryStep();
    } catch (const Interrupted&) {  // no step was taken yet: x is the best state
      minimum_.interrupted = true;
      return TerminateByUser();
    }
  }

  bool TryStep() {
    iteration_start_ = Clock::now();
    const IterationRecord& previous = minimum_.iterations.back();
    record_ = IterationRecord();
    record_.iteration = previous.iteration + 1;
    record_.gradient_max_norm = previous.gradient_max_norm;

    Step step = strategy_->ComputeStep(&problem_);
    record_.linear_solver_iterations = step.num_iterations;
    if (step.status == LinearStatus::kFatal) {
      return Terminate("FAILURE", "Linear solver failed due to unrecoverable non-numeric causes. " +
                                      step.message);
    }
    const bool is_valid =
        step.status == LinearStatus::kSuccess && step.candidate.model_cost_change > 0;
    if (!is_valid) return HandleInvalidStep();
    num_consecutive_invalid_steps_ = 0;

    Candidate& candidate = step.candidate;
    if (problem_.HasBounds() && !(RelativeDecrease(candidate) > options_.min_relative_decrease)) {
      SearchAlongStep(x_.cost + x_.held, &problem_, &candidate);
    }
    if (!std::isfinite(candidate.cost)) candidate.cost = kNoCost;
    record_.step_norm = candidate.step_norm;
    record_.changes_what_counts = candidate.changes_what_counts;
    record_.cost_change = Decrease(x_, candidate);
    const bool ends = ParameterToleranceIsMet() || FunctionToleranceIsMet();
    const bool is_coarse = options_.function_tolerance > kTightTolerance;
    if (ends && is_coarse && candidate.has_factors && !is_settling_) {
      is_settling_ = true;
      has_succeeded_ = false;
      if (strategy_->Widen()) return TryStep();
    }
    if (ParameterToleranceReached(candidate.model_cost_change) || FunctionToleranceReached()) {
      return false;
    }

    record_.relative_decrease = RelativeDecrease(candidate);
    if (record_.relative_decrease > options_.min_relative_decrease) {
      const bool settles = !is_settling_ || candidate.factors_change <= options_.function_tolerance;
      const double decrease = candidate.changes_what_counts
                                  ? std::numeric_limits<double>::quiet_NaN()
                                  : record_.cost_change;
      const bool meets_tolerance = FunctionToleranceIsMet() && settles;
      may_end_ = end_.MayEnd(decrease, candidate.cost, meets_tolerance) &&
                 (is_settling_ || end_.takes_last_step());
      return HandleSuccessfulStep(candidate);
    }
    if (end_.takes_last_step() && !end_.IsKnown() && FunctionToleranceIsMet()) {
      return !ConvergeByFunctionTolerance();
    }
    record_.cost = candidate.cost;
    strategy_->StepRejected();
    return true;
  }

  bool HandleInvalidStep() {
    if (++num_consecutive_invalid_steps_ >= options_.max_num_consecutive_invalid_steps) {
      return Terminate("FAILURE",
                       "Number of consecutive invalid steps more than "
                       "Solver::Options::max_num_consecutive_invalid_steps: " +
                           std::to_string(options_.max_num_consecutive_invalid_steps));
    }
    record_.cost = x_.cost;
    strategy_->StepIsInvalid();
    return true;
  }

  bool HandleSuccessfulStep(const Candidate& candidate) {
    problem_.Accept();
    strategy_->StepAccepted(CertainQuality(candidate));
    record_.cost = candidate.cost;
    record_.step_is_successful = true;
    end_.JudgeState(record_);
    const bool measures = may_end_ && end_.CanMeasure();
    try {
      if (!LinearizeAtX(measures)) {
        problem_.Accept();
        return Terminate("FAILURE", "Residual and Jacobian evaluation failed.");
      }
      if (may_end_) {
        may_end_ = end_.Ends(x_.cost);
        if (measures && !may_end_ && !LinearizeAtX()) {
          return Terminate("FAILURE", "Residual and Jacobian evaluation failed.");
        }
      }
    } catch (const Interrupted&) {  // the step was taken; its record has the previous gradient
      minimum_.interrupted = true;
      return true;
    }
    current_ = {candidate.cost, candidate.held_cost};
    has_succeeded_ = true;
    return true;
  }

  bool LinearizeAtX(bool for_decrement = false) {
    const Linearization linearization =
        problem_.Linearize(for_decrement ? LeastSquares::kDecrementDamping : strategy_->Damping());
    if (!linearization.is_finite) return false;
    x_ = {linearization.cost, linearization.held_cost};
    record_.cost = x_.cost;
    record_.gradient_max_norm = linearization.gradient_max_norm;
    return true;
  }

  /// Both parts are differences of numbers of similar size; the held cost hardly changes.
  static double Decrease(const Costs& from, const Candidate& to) {
    return (from.cost - to.cost) + (from.held - to.held_cost);
  }

  double RelativeDecrease(const Candidate& candidate) const {
    if (candidate.cost == kNoCost) return std::numeric_limits<double>::lowest();
    return Decrease(current_, candidate) / candidate.model_cost_change;
  }

  /// The digits of a step's quality that do not depend on the order of summation. With the other
  /// digits, the next radius and all further results would depend on it.
  double CertainQuality(const Candidate& candidate) const {
    return RoundTo(candidate.cost_uncertainty / candidate.model_cost_change,
                   record_.relative_decrease);
  }

  bool StoppedByUser() {
    const bool stopped = progress_ && !progress_(record_);
    minimum_.interrupted = minimum_.interrupted || stopped;
    if (!minimum_.interrupted) return false;
    TerminateByUser();
    return true;
  }

  bool TerminateByUser() {
    return Terminate("USER_SUCCESS", "User callback returned SOLVER_TERMINATE_SUCCESSFULLY.");
  }

  bool MaxNumIterationsReached() {
    if (record_.iteration < options_.max_num_iterations) return false;
    Terminate("NO_CONVERGENCE", "Maximum number of iterations reached. Number of iterations: " +
                                    std::to_string(record_.iteration) + ".");
    return true;
  }

  bool GradientToleranceReached() {
    const double norm = record_.gradient_max_norm;
    if (norm > options_.gradient_tolerance) return false;
    return Converge("Gradient tolerance reached. Gradient max norm: " +
                    AtMost(norm, options_.gradient_tolerance));
  }

  bool MinRadiusReached() {
    if (record_.trust_region_radius > options_.min_trust_region_radius) return false;
    return Converge("Minimum trust region radius reached. Trust region radius: " +
                    AtMost(record_.trust_region_radius, options_.min_trust_region_radius));
  }

  double StateSize() const { return problem_.StateNorm() + options_.parameter_tolerance; }

  bool ParameterToleranceIsMet() const {
    return has_succeeded_ && !(record_.step_norm > options_.parameter_tolerance * StateSize());
  }

  bool FunctionToleranceIsMet() const {
    return !(std::abs(record_.cost_change) > options_.function_tolerance * x_.cost);
  }

  bool ParameterToleranceReached(double model_cost_change) {
    if (!ParameterToleranceIsMet()) return false;
    minimum_.untaken_decrease = model_cost_change;
    return Converge("Parameter tolerance reached. Relative step_norm: " +
                    AtMost(record_.step_norm / StateSize(), options_.parameter_tolerance) + ".");
  }

  bool FunctionToleranceReached() {
    const double change = std::abs(record_.cost_change);
    const bool is_taken = is_settling_ || end_.takes_last_step();
    if (!FunctionToleranceIsMet() || (is_taken && change > kLostChange * x_.cost)) return false;
    return ConvergeByFunctionTolerance();
  }

  bool ConvergeByFunctionTolerance() {
    return Converge("Function tolerance reached. |cost_change|/cost: " +
                    AtMost(std::abs(record_.cost_change) / x_.cost, options_.function_tolerance));
  }

  /// Returns true, for a test of convergence.
  bool Converge(std::string message) { return !Terminate("CONVERGENCE", std::move(message)); }

  /// Returns false, for a solve that cannot continue.
  bool Terminate(const char* type, std::string message) {
    minimum_.termination_type = type;
    minimum_.message = std::move(message);
    return false;
  }

  const SolveOptions& options_;
  const ProgressCallback& progress_;
  MinimizerSummary minimum_;
  TimedProblem problem_;
  std::unique_ptr<Strategy> strategy_;
  const Clock::time_point start_ = Clock::now();
  Clock::time_point iteration_start_ = start_;
  IterationRecord record_;
  double seconds_before_ = 0;
  Costs x_;        ///< costs of the linearisation at x
  Costs current_;  ///< also at x, by the candidate's evaluation; the reference for decreases
  bool has_succeeded_ = false;
  bool is_settling_ = false;  ///< met a tolerance, with factors other than observations
  SolveEnd end_;
  bool may_end_ = false;  ///< the solve ends with the last step, which was taken
  int num_consecutive_invalid_steps_ = 0;
};

}  // namespace

MinimizerSummary Minimize(const SolveOptions& options, const ProgressCallback& progress,
                          LeastSquares* problem, MinimizerSummary before) {
  return TrustRegion(options, progress, problem, std::move(before)).Run();
}

}  // namespace bundle
