#include "core/solve/prepare.h"

#include <utility>

#include "core/problem/reprojection_errors.h"
#include "core/solve/free_parameters.h"
#include "core/solve/gauge.h"
#include "core/solve/plausibility.h"

namespace bundle {

PreparedSolve PrepareSolve(const ProblemView& problem, const SolveOptions& options) {
  CheckCameraModelsKnown(problem);
  FreeParameters free = SelectFreeParameters(problem, options);
  std::vector<Warning> warnings;
  Warn(WarningKind::kGaugeNotHeld, FixGauge(problem, options.gauge, &free), &warnings);
  ParameterLayout layout(problem, std::move(free));
  Warn(WarningKind::kPointsSeenOnce, CountPointsSeenOnce(problem, layout), &warnings);
  return {std::move(layout), std::move(warnings)};
}

}  // namespace bundle
