#include "core/checking/steep_end.h"

/// Detection of a solve whose steps became too short before its gradient became small.
///
/// Parameter tolerance and trust region radius test the size of steps, not their decrease. They end
/// a solve far from a minimum if the cost jumps or bends away from its model, or if a unit of
/// length makes every step look small. Ceres calls that convergence.
///
/// The remaining decrease is estimated from the predictions of the last steps. Notation as in
/// convergence_watch.cpp: p = -g^T d - 1/2 d^T G d is the predicted decrease, R the radius, D the
/// scale of the columns. A damped step is d = -(G + D^2 / R)^-1 g, with
///
///   p = 1/2 g^T (G + D^2 / R)^-1 g + 1/2 |D d|^2 / R,
///
/// which tends to R g^T D^-2 g as R falls, so that
///
///   p max(1, 1 / R)
///
/// is about the predicted decrease of a step of radius 1. With D_j^2 that of column j of J, it is
/// the sum of each coordinate's own decrease. A dogleg step ends at |D d| = R, with p -> R |D^-1
/// g|, and a radius of 1 predicts 1/2 (p / R)^2. Rejected steps all start from the last state. So
/// does the step that met the parameter tolerance and was not taken.
///
/// The decrease counts if it exceeds the function tolerance (at least 1e-5) and rounding errors:
/// kSmallestGain in the root mean square of the residuals.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <sstream>
#include <string>

namespace bundle {
namespace {

constexpr double kSmallestShare = 1e-5;
constexpr double kSmallestGain = 1e-5;  // pixels; of factors: sigmas

bool StartsWith(const std::string& text, const char* beginning) {
  return text.rfind(beginning, 0) == 0;
}

/// Predicted decrease of a step of radius 1, given the predicted decrease p at this radius.
double AtUnitRadius(double p, double radius, bool is_dogleg) {
  if (!(radius < 1) || !(radius > 0)) return p;
  return is_dogleg ? std::max(p, 0.5 * (p / radius) * (p / radius)) : p / radius;
}

double PromisedAtEnd(const SolveRecord& record) {
  const bool is_dogleg = record.summary.trust_region_strategy_type == "DOGLEG";
  const std::vector<IterationRecord>& steps = record.iterations;
  double promised =
      AtUnitRadius(record.summary.untaken_decrease, steps.back().trust_region_radius, is_dogleg);
  for (size_t k = steps.size(); --k > 0 && !steps[k].step_is_successful;) {
    const double p = steps[k].cost_change / steps[k].relative_decrease;
    if (!std::isfinite(p) || !(std::abs(steps[k].relative_decrease) < 1e300)) continue;
    promised = std::max(promised, AtUnitRadius(p, steps[k - 1].trust_region_radius, is_dogleg));
  }
  return promised;
}

}  // namespace

std::string FindSteepEnd(const SolveRecord& record, double function_tolerance) {
  const SolveSummary& summary = record.summary;
  const bool by_parameters = StartsWith(summary.message, "Parameter tolerance");
  if (summary.termination_type != "CONVERGENCE" || record.iterations.empty() ||
      !(by_parameters || StartsWith(summary.message, "Minimum trust region radius"))) {
    return "";
  }
  const double promised = PromisedAtEnd(record);
  const double share = std::max(kSmallestShare, function_tolerance) * summary.final_cost;
  const double rounding = 0.5 * summary.num_residuals * kSmallestGain * kSmallestGain;
  if (!(promised > share) || !(promised > rounding)) return "";
  std::ostringstream sentence;
  sentence << "The solve ended by its "
           << (by_parameters ? "parameter tolerance" : "trust region radius")
           << ", not by a small gradient (" << record.iterations.back().gradient_max_norm
           << " at most): a step without that limit is predicted to lower the cost by about "
           << std::min(1.0, promised / summary.final_cost) * 100
           << " %. This is not a minimum, or the cost is discontinuous here.";
  return sentence.str();
}

}  // namespace bundle
