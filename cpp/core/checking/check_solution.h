#pragma once

/// Checks at the end of a solve: is the Jacobian right, is the solution one.

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/factors/reprojection.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// The indices, ascending, of about `size` observations, the same at each call: as many of each
/// camera model that observes anything, and of each image with that model as far as it has them.
/// Takes some 3 ns an observation of the problem.
std::vector<int64_t> SampleObservations(const ProblemView& problem, int64_t size);

/// An observation and the numbers that its residual depends on: x = (v, t, parameters of the
/// model, point), v as in factors/reprojection.h; of an image of a rig (v, t) are local
/// coordinates.
struct ObservationAtPoint {
  static constexpr int kMaxSize = kPoseSize + kMaxCameraParams + 3;

  int64_t observation = 0;
  const CameraModel* model = nullptr;
  uint32_t free = 0;  ///< bit j: x_j is refined; the others are not checked
  double x[kMaxSize] = {};

  int size() const { return kPoseSize + model->num_params + 3; }
};

/// The residual (2) of an observation at x and, unless `jacobian` is nullptr, the derivatives that
/// are claimed for it: 2 x size, row-major. False where the observation does not count.
using ClaimedDerivatives =
    std::function<bool(int64_t observation, const double* x, double* residual, double* jacobian)>;

/// Holds the claimed Jacobian columns against differences of the residual (spot_check.cpp). One
/// sentence that says which kind of column is wrong by how much, and names `bundle check`; "" if
/// none is. Takes some 5 microseconds an observation.
std::string SpotCheck(const std::vector<ObservationAtPoint>& sample,
                      const ClaimedDerivatives& derivatives);

/// The reprojection residuals of a solve as a spot check sees them: where the solve is, in its own
/// charts. Keeps references to everything.
class SolutionUnderCheck {
 public:
  /// `points` as in ProblemView.
  SolutionUnderCheck(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const CameraStates& states, const std::vector<double>& points,
                     Cheirality cheirality);

  /// Observations with something to refine, spread over camera models and images.
  std::vector<ObservationAtPoint> Sample() const;

  /// ClaimedDerivatives of EvaluateReprojection.
  bool operator()(int64_t observation, const double* x, double* residual, double* jacobian) const;

 private:
  uint32_t FreeColumns(int64_t observation) const;

  const AdjustmentProblem& problem_;
  const ParameterLayout& layout_;
  const CameraStates& states_;
  const std::vector<double>& points_;
  const Cheirality cheirality_;
};

/// The sentence of SpotCheck about a solution, "" if its Jacobians are right.
std::string CheckSolution(const AdjustmentProblem& problem, const ParameterLayout& layout,
                          const CameraStates& states, const std::vector<double>& points,
                          Cheirality cheirality);

/// One sentence that counts the free points seen by one observation only; "" if there are none.
std::string CountPointsSeenOnce(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                const std::vector<int64_t>& track_lengths);

/// If the solver left something that is no reconstruction (a focal length that is not positive, a
/// number that is not finite), puts the problem's own values back, marks the solution as not usable
/// and says why in the warnings. Returns true if so.
bool RejectImpossibleSolution(const AdjustmentProblem& problem, SolveOutput* output);

/// One sentence that names the first observation whose squared residual is not finite at the
/// problem's own values; "" if there is none.
std::string FindOverflow(const ProblemView& problem, Cheirality cheirality);

/// Of the observations that count at the start, how many may end behind their cameras.
inline constexpr double kMaxLostShare = 0.01;

/// Judges a solve with `num_held` observations with something to refine that hold a residual at the
/// problem's values, on all ranks, the number of those that could count: they are in front of their
/// cameras.
int64_t CountLeftOut(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const SolveOptions& options, int64_t num_held);

/// Looks for observations that do not count at the solution: behind their cameras or, if those
/// behind count, without a projection. More of them than at the start, an image with no others, or
/// observations that would count but were left out, having been behind before, make a warning with
/// numbers and image ids. With more than `kMaxLostShare` lost the solution is not usable, as its
/// cost says little of it. `num_held`: observations with something to refine that hold a residual
/// at the solution (factors/reprojection.h).
void JudgeLostObservations(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const SolveOptions& options, int64_t num_held, SolveOutput* output);

/// Looks for the signature of a wrong Jacobian in the iterations (convergence_watch.cpp). One
/// sentence that says what was seen and ends with `advice`, what finds the mistake; "" if nothing
/// was.
std::string WatchConvergence(const std::vector<IterationRecord>& iterations,
                             const std::string& advice = "`bundle check` finds out");

/// One sentence about a solve that ended by parameter tolerance or radius where its model still
/// predicts a decrease (steep_end.cpp); "" about any other.
std::string FindSteepEnd(const SolveRecord& record, double function_tolerance);

/// Judges the end of a solve of anything by its record: one whose cost or gradient is not finite
/// fails, one that ended by short steps on a slope has a warning. With bounds a gradient may point
/// out of them, and no slope is told.
void JudgeEnd(bool has_bounds, double function_tolerance, SolveRecord* record);

/// What every backend ends with: looks at the iterations and the solution that a backend left in
/// `output`, says in its warnings, after `warnings`, what is wrong with them, and drops a solution
/// that is none. Without SolveOptions::check_solution it does not look for signs of a wrong
/// Jacobian; it always looks for what makes a solution unusable. `states` are the camera parameters
/// of the solution; `num_held` is the number of observations that hold a residual there
/// (factors/reprojection.h).
void FinishSolve(const AdjustmentProblem& problem, const ParameterLayout& layout,
                 const CameraStates& states, const SolveOptions& options,
                 std::vector<Warning> warnings, int64_t num_held, SolveOutput* output);

}  // namespace bundle
