#pragma once

/// End of a solve by the trust region method, where it differs from Ceres:
///
/// * The end of a problem with degrees of freedom (LeastSquares::DegreesOfFreedom): a step that
///   meets the function tolerance is taken, if it lowers the cost, and ends the solve if it is also
///   near the minimum in standard deviations (minimize/sigma_rule.h).
/// * A solve that ends by its iteration limit or by the user returns the state of the least
///   LeastSquares::CostOfAll, for which observations that were left out count again.

#include <optional>

#include "core/interface/summary.h"
#include "core/minimize/least_squares.h"
#include "core/minimize/sigma_rule.h"
#include "core/minimize/trust_region.h"

namespace bundle {

class SolveEnd {
 public:
  /// `degrees_of_freedom`: those of the problem. Keeps references to problem and summary.
  SolveEnd(std::optional<double> degrees_of_freedom, LeastSquares* problem,
           MinimizerSummary* minimum)
      : takes_last_step_(degrees_of_freedom.has_value()),
        rule_(degrees_of_freedom.value_or(0)),
        problem_(*problem),
        minimum_(*minimum) {}

  /// True if the step that meets the function tolerance is taken.
  bool takes_last_step() const { return takes_last_step_; }
  bool IsKnown() const { return rule_.IsKnown(); }
  bool CanMeasure() const { return IsKnown() && problem_.HasDecrement(); }

  /// SigmaRule::MayEnd, for a step that is accepted.
  bool MayEnd(double decrease, double cost, bool meets_function_tolerance);
  /// Decides if the solve ends with the last step, at the cost of x. If CanMeasure, x has been
  /// linearised for the decrement.
  bool Ends(double cost);
  /// Compares the state with the best one. Call after each change of the state.
  void JudgeState(const IterationRecord& record);
  /// Measures the distance of the end at x, or returns to the best state.
  void Finish(double cost);

 private:
  NewtonDecrement Measure(double cost);
  void SetDistance(const NewtonDecrement& decrement, double cost);

  const bool takes_last_step_;
  SigmaRule rule_;
  LeastSquares& problem_;
  MinimizerSummary& minimum_;
  bool has_decrement_ = false;  ///< the summary has the distance at x
  bool has_state_ = false;      ///< a state was judged
};

}  // namespace bundle
