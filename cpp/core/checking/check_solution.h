#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/factors/reprojection.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"

namespace bundle {

/// The indices, ascending, of about `size` observations, the same at each call: as many of each
/// camera model that observes anything, and of each image with that model as far as it has them.
/// Takes some 3 ns an observation of the problem.
std::vector<int64_t> SampleObservations(const ProblemView& problem, int64_t size);

/// A spot check of the linearisation: at a sample of observations, each column of the claimed
/// Jacobian is held against differences of the residual. The iterations of a solve do not tell a
/// column that is far too small from bad scaling (WatchConvergence); this does.
///
/// Along the axis of one number x_j, with D(h) = (r(x + h e_j) - r(x - h e_j)) / 2h,
///
///   R = D(h/2) + (D(h/2) - D(h)) / 3 = dr/dx_j + O(h^4),     u = ||D(h/2) - D(h)||,
///
/// where u, of order h^2, is far above the error of R wherever r is smooth at the scale of h, and
/// of the size of R where it is not: across a fold, a seam or the camera's plane. Rounding adds n /
/// h to u, with n = eps (||r|| + sum_k |x_k| ||J_k||), what the last digits of x and r may change.
/// A step is *conclusive* if u is below a hundredth of ||R||. The column J_j then agrees with it if
///
///   ||J_j - R|| < 1e-3 max(||J_j||, ||R||) + 4 u.
///
/// h moves the residual by a given part of a pixel, as the largest claimed column of j's kind has
/// it (rotation, translation, point, or the one parameter): for true columns that is a scale at
/// which the residual is nearly linear, be coordinates 1e-9 or 1e9, and false ones, 1000 times too
/// large or too small, are still seen at one of four such scales. Where nothing seems to move, the
/// size of what is moved bounds h. A needle narrower than h may yet look smooth: near the pole of a
/// panorama, say, or a camera's centre. So
///
/// - any conclusive step that agrees acquits the observation's column,
/// - two conclusive steps, 100 times apart or more, that agree and are not J_j convict it,
/// - everything else leaves it undecided,
///
/// and a column is reported where it is convicted in a quarter, and four, of the decided
/// observations of a camera model, which must be a tenth of those tried: however hard a problem,
/// the residual would have to mislead at every scale in many places. What this leaves to `bundle
/// check`: columns that are wrong in a few observations or by less than one in a thousand, and
/// columns that should be zero and are not, since a residual that lost its last digit does not move
/// either.

/// An observation and the numbers that its residual depends on: x = (w, t, parameters of the
/// model, point).
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

/// One sentence that says which kind of column is wrong by how much, and names `bundle check`; ""
/// if nothing is. Takes some 5 microseconds an observation.
std::string SpotCheck(const std::vector<ObservationAtPoint>& sample,
                      const ClaimedDerivatives& derivatives);

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

/// One sentence that counts the free points seen by one observation only; "" if there are none.
std::string CountPointsSeenOnce(const ProblemView& problem, const ParameterLayout& layout,
                                const std::vector<int64_t>& track_lengths);

/// If the solver left something that is no reconstruction (a focal length that is not positive, a
/// number that is not finite), puts the problem's own values back, marks the solution as not usable
/// and says why in the warnings. Returns true if so.
bool RejectImpossibleSolution(const ProblemView& problem, SolveOutput* output);

/// One sentence that names the first observation whose squared residual is not finite at the
/// problem's own values; "" if there is none.
std::string FindOverflow(const ProblemView& problem, Cheirality cheirality);

/// Of the observations that count at the start, how many may end behind their cameras.
inline constexpr double kMaxLostShare = 0.01;

/// Looks for observations that do not count at the solution: behind their cameras or, if those
/// behind count, without a projection. More of them than at the start, an image with no others, or
/// observations that would count but were left out, having been behind before, make a warning with
/// numbers and image ids. With more than `kMaxLostShare` lost the solution is not usable, as its
/// cost says little of it. `num_held`: observations with something to refine that hold a residual
/// at the solution (factors/reprojection.h).
void JudgeLostObservations(const ProblemView& problem, const ParameterLayout& layout,
                           const SolveOptions& options, int64_t num_held, SolveOutput* output);

/// The signature of a lying Jacobian in the iterations of a solve.
///
/// A wrong Jacobian rarely crashes: the cost still falls, only less than promised. Two things about
/// a trust region method with true derivatives cannot be had with false ones, and both can be read
/// off the trace alone. Notation: f the cost, g its gradient J^T r, G = J^T J, H the true Hessian
/// of f, d a step, p = -g^T d - 1/2 d^T G d > 0 the decrease that the model predicts, q = (actual
/// decrease) / p Ceres' relative_decrease, R the trust region radius, m = D / (R G) the damping of
/// a direction.
///
/// 1. Shorter steps make the model right. To second order
///
///      (1 - q) p = 1/2 d^T (H - G) d,
///
///    which vanishes faster than p: once R is so small that p is proportional to it (d follows the
///    scaled gradient), 1 - q is proportional to R as well, whatever the problem. With a gradient
///    J^T r that is not f's, q tends to (true slope) / (promised slope) along d instead: it
///    settles, often below zero. The watch looks for a *ladder*: successive steps, each with a
///    smaller R and a p that shrinks with it, over which 1 - q stays what it was. Rejected steps
///    all start from one point, and p falling 32 times is enough; accepted ones move on, so p has
///    to fall 100 times over six rungs at one gradient. Two honest things keep 1 - q up for a
///    while, and neither is taken for a lie: where the cost jumps or saturates (a point passes
///    behind its camera; Tukey's loss) the actual change does not shrink with p, so that |q| grows;
///    and undamped steps do not shrink. Outliers, bad starts and valleys make R oscillate, where q
///    recovers as R falls.
///
/// 2. A linear tail tells its rate twice. Along the slowest direction an error e becomes l e. True
///    derivatives give a step of -H e / (G (1 + m)), hence
///
///      l = 1 - H / (G (1 + m)),     q = (1 + l) (1 + m) / (1 + 2 m),   in [(1 + l) / 2, 1 + l],
///
///    with l of either sign: slow progress shows as q near 2 (robust losses, where G exceeds H), as
///    q near 0 (steps that overshoot) or, damped, as q = 1. Decreases fall by l^2 a step, so that
///    |l| is seen as well, and true derivatives exclude every q between 1 - |l| and (1 + |l|) / 2;
///    with m = 0, which shows where R changed and l did not, everything between 1 - |l| and 1 +
///    |l|. A Jacobian column that is c times too large makes steps 1 / c as long at the promise of
///    whole ones: l = 1 - 1 / c and q = 1 - l^2 (1/2 and 3/4 for c = 2). One too small overshoots
///    until damping holds it: R falls step by step, at q below 1/2 and l near 0.8. The watch wants
///    |l| and q constant over five steps, ten of the second kind, and gradient and step length to
///    fall by |l| too. Without that no error shrinks in proportion, as in a curved valley, or where
///    points go to infinity (r = 1 / z has q = 3/4 at l = 1/2, but steps that double).
///
/// Changes of the cost near its rounding errors are no evidence. The bounds are set where several
/// thousand honest solves, made as hard as one can, keep silent; that costs some
/// lies. Those that leave no signature (a column far too small makes damping oscillate as any badly
/// scaled problem does) are for the spot check to find (SpotCheck).

/// One sentence that says what was seen and names `bundle check`; "" if nothing was.
std::string WatchConvergence(const std::vector<IterationRecord>& iterations);

/// What every backend ends with: looks at the iterations and the solution that a backend left in
/// `output`, says in its warnings, after `warnings`, what is wrong with them, and drops a solution
/// that is none. `states` is the camera side of the solution; `num_held` is the number of
/// observations that hold a residual there (factors/reprojection.h).
void FinishSolve(const ProblemView& problem, const ParameterLayout& layout,
                 const CameraStates& states, const SolveOptions& options,
                 std::vector<Warning> warnings, int64_t num_held, SolveOutput* output);

}  // namespace bundle
