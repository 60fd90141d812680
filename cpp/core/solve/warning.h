#pragma once

/// What a user should know about a solve, in words and as a name that programs can rely on.

#include <string>
#include <utility>
#include <vector>

#include "core/solve/options.h"

namespace bundle {

/// python/bundle/warning_kinds.py says what each means (a test holds the names against each other).
enum class WarningKind {
  kGaugeNotHeld,
  kPointsSeenOnce,
  kFarOrigin,
  kFarPoints,
  kFarPointsDominate,
  kSingleThread,
  kPreconditionerNotUsed,
  kOrderingNotUsed,
  kOrderingReplaced,
  kSolverReplaced,
  kPreconditionerReplaced,
  kFactorLargerThanPredicted,
  kResidualNotFinite,
  kSuspiciousSteps,
  kSuspiciousJacobian,
  kInvalidSolution,
  kObservationsBehind,
  kTooManyBehind,
  kObservationsLeftOut,
};

inline constexpr NamedValue<WarningKind> kWarningKinds[] = {
    {"gauge_not_held", WarningKind::kGaugeNotHeld},
    {"points_seen_once", WarningKind::kPointsSeenOnce},
    {"far_origin", WarningKind::kFarOrigin},
    {"far_points", WarningKind::kFarPoints},
    {"far_points_dominate", WarningKind::kFarPointsDominate},
    {"single_thread", WarningKind::kSingleThread},
    {"preconditioner_not_used", WarningKind::kPreconditionerNotUsed},
    {"ordering_not_used", WarningKind::kOrderingNotUsed},
    {"ordering_replaced", WarningKind::kOrderingReplaced},
    {"solver_replaced", WarningKind::kSolverReplaced},
    {"preconditioner_replaced", WarningKind::kPreconditionerReplaced},
    {"factor_larger_than_predicted", WarningKind::kFactorLargerThanPredicted},
    {"residual_not_finite", WarningKind::kResidualNotFinite},
    {"suspicious_steps", WarningKind::kSuspiciousSteps},
    {"suspicious_jacobian", WarningKind::kSuspiciousJacobian},
    {"invalid_solution", WarningKind::kInvalidSolution},
    {"observations_behind", WarningKind::kObservationsBehind},
    {"too_many_behind", WarningKind::kTooManyBehind},
    {"observations_left_out", WarningKind::kObservationsLeftOut}};

struct Warning {
  WarningKind kind;
  std::string text;  ///< one sentence
};

/// Appends a warning, unless its sentence is "": there is nothing to say.
inline void Warn(WarningKind kind, std::string text, std::vector<Warning>* warnings) {
  if (!text.empty()) warnings->push_back({kind, std::move(text)});
}

}  // namespace bundle
