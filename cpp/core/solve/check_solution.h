#pragma once

#include <string>
#include <vector>

#include "core/problem/problem_view.h"
#include "core/residuals/reprojection.h"
#include "core/solve/camera_states.h"
#include "core/solve/parameter_layout.h"
#include "core/solve/spot_check.h"

namespace bundle {

/// The reprojection residuals of a solve as a spot check sees them: where the solve is, in its own
/// charts. Keeps references to everything.
class SolutionUnderCheck {
 public:
  /// `points` as in ProblemView.
  SolutionUnderCheck(const ProblemView& problem, const ParameterLayout& layout,
                     const CameraStates& states, const std::vector<double>& points,
                     Cheirality cheirality);

  /// Observations with something to refine, spread over camera models and images.
  std::vector<ObservationAtPoint> Sample() const;

  /// ClaimedDerivatives of EvaluateReprojection.
  bool operator()(int64_t observation, const double* x, double* residual, double* jacobian) const;

 private:
  uint32_t FreeColumns(int64_t observation) const;

  const ProblemView& problem_;
  const ParameterLayout& layout_;
  const CameraStates& states_;
  const std::vector<double>& points_;
  const Cheirality cheirality_;
};

/// The sentence of SpotCheck about a solution, "" if its Jacobians are right.
std::string CheckSolution(const ProblemView& problem, const ParameterLayout& layout,
                          const CameraStates& states, const std::vector<double>& points,
                          Cheirality cheirality);

}  // namespace bundle
