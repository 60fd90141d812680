#include "core/solve/prepare.h"

#include <utility>

#include "core/problem/reprojection_errors.h"
#include "core/problem/tracks.h"
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
  std::vector<int64_t> track_lengths = TrackLengths(problem);
  Warn(WarningKind::kPointsSeenOnce, CountPointsSeenOnce(problem, layout, track_lengths),
       &warnings);
  return {std::move(layout), std::move(warnings), std::move(track_lengths)};
}

}  // namespace bundle
