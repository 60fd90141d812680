#pragma once

/// Checks at the end of a solve, of the Jacobian and of the solution.

#include <cstdint>
#include <string>
#include <vector>

#include "core/checking/spot_check.h"
#include "core/factors/reprojection.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// Returns the indices, ascending, of about `size` observations, the same at each call. The sample
/// has the same number of observations of each camera model that occurs, and of each image with
/// this model if the image has enough. Takes some 3 ns per observation of the problem.
std::vector<int64_t> SampleObservations(const ProblemView& problem, int64_t size);

/// Reprojection residuals of a solve at its state and in its charts, for a spot check. Keeps
/// references to all arguments.
class SolutionUnderCheck {
 public:
  /// `points` as in ProblemView.
  SolutionUnderCheck(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const CameraStates& states, const LargeVector<double>& points,
                     Cheirality cheirality);

  /// Observations with free parameters, spread over camera models and images.
  std::vector<ObservationAtPoint> Sample() const;

  /// ClaimedDerivatives from EvaluateReprojection.
  bool operator()(int64_t observation, const double* x, double* residual, double* jacobian) const;

 private:
  uint32_t FreeColumns(int64_t observation) const;

  const AdjustmentProblem& problem_;
  const ParameterLayout& layout_;
  const CameraStates& states_;
  const LargeVector<double>& points_;
  const Cheirality cheirality_;
};

/// The message of SpotCheck about a solution; "" if its Jacobians are right.
std::string CheckSolution(const AdjustmentProblem& problem, const ParameterLayout& layout,
                          const CameraStates& states, const LargeVector<double>& points,
                          Cheirality cheirality);

/// Returns a message with the number of free points with one observation only; "" without such
/// points.
std::string CountPointsSeenOnce(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                const LargeVector<int64_t>& track_lengths);

/// Rejects an impossible solution (a focal length that is not positive, a number that is not
/// finite): restores the problem's own values, marks the solution as not usable, and warns. Returns
/// true in this case.
bool RejectImpossibleSolution(const AdjustmentProblem& problem, SolveOutput* output);

/// Returns a message with the first observation whose squared residual is not finite at the
/// problem's own values; "" if all are finite.
std::string FindOverflow(const ProblemView& problem, Cheirality cheirality);

/// Checks the end of a solve by its record, for any backend. A solve whose cost or gradient is not
/// finite fails. A solve that ended by short steps on a slope gets a warning, except with bounds,
/// where the gradient may point out of them.
void JudgeEnd(bool has_bounds, double function_tolerance, SolveRecord* record);

/// Last step of each backend. Checks the iterations and the solution in `output`, adds warnings to
/// `warnings`, and rejects an impossible solution. Without SolveOptions::check_solution it does not
/// search for signs of a wrong Jacobian, but always for errors that make a solution unusable.
/// `states` are the camera parameters of the solution. `num_held` is the number of observations
/// with a held residual there (factors/reprojection.h).
void FinishSolve(const AdjustmentProblem& problem, const ParameterLayout& layout,
                 const CameraStates& states, const SolveOptions& options,
                 std::vector<Warning> warnings, int64_t num_held, SolveOutput* output);

}  // namespace bundle
