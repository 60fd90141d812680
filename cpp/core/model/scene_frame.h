#pragma once

/// Scenes whose origin is far outside them, and points far outside their scene.
///
/// Both harm a solver. A rotation turns the world about its origin: from afar, every turn of a
/// camera moves it by far more than the scene measures, which its translation has to undo, and
/// neither the damping nor the rounding is made for that. And the parameter tolerance stops a solve
/// once
/// ||step|| <= tolerance ||x||, where one large coordinate makes every step look small.
///
/// So a scene that is more than kFarOrigin times its size away from the origin (UTM coordinates,
/// for instance) is solved about a point c at its centre. With X' = X - c and t' = t + R c it is R
/// X' + t' = R X + t: no residual changes. The solution is moved back; unchanged values keep their
/// bits.
///
/// Points more than kFarPoint sizes away from the centre stay in the problem, but not in the norm:
/// the tolerance is multiplied by ||x without them|| / ||x||.
///
/// The centre is the median of the images' projection centres, coordinate by coordinate; the size
/// is the median distance of some thousand points from it.
///
/// The scene is solved about the point that COLMAP's normalisation puts at the origin: per
/// coordinate, the mean of the projection centres between their 10th and 90th percentile. Damping
/// depends on where the origin is, and with it how many steps a slow valley takes until the
/// function tolerance stops the solve: a COLMAP model that was moved gets the steps back that it
/// had before. It is the centre where more than a tenth of the images stand far away from the
/// others.

#include <cstdint>
#include <string>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"

namespace bundle {

inline constexpr double kFarOrigin = 100;
inline constexpr double kFarPoint = 1000;
inline constexpr double kMaxNearRise = 2;
inline constexpr double kFarPull = 1;

struct SceneFrame {
  double center[3] = {};
  double origin[3] = {};  ///< to solve a scene about that is far from its own
  double size = 0;        ///< 0 without images or points
  double reach = 0;       ///< distance of the farthest point
  double unit = 1;        ///< in lengths of the problem that users know (world_scale.h)

  explicit SceneFrame(const AdjustmentProblem& problem);

  bool IsFarFromOrigin() const;
  double DistanceTo(const double* point) const;
};

/// A problem about the centre of its scene, if the origin is far outside it, or else itself.
class CenteredProblem {
 public:
  /// Keeps a reference to the problem.
  CenteredProblem(const AdjustmentProblem& problem, const SceneFrame& frame);
  CenteredProblem(const CenteredProblem&) = delete;
  CenteredProblem& operator=(const CenteredProblem&) = delete;

  const AdjustmentProblem& view() const { return centered_; }
  bool is_moved() const { return !points_.empty(); }

  /// Moves a solution of view() to where the problem is.
  void MoveBack(SolveOutput* output) const;

 private:
  const AdjustmentProblem& problem_;
  const SceneFrame& frame_;
  std::vector<double> cam_from_world_;
  std::vector<double> rig_from_world_;
  std::vector<double> points_;
  AdjustmentProblem centered_;
};

/// The points far outside the scene that take part: with observations that have something to
/// refine.
struct FarPoints {
  double norm_without = 1;  ///< ||x without them|| / ||x|| at the start, x all that is free
  std::vector<int64_t> observations;  ///< theirs, of those that have something to refine
  int64_t num_observations = 0;       ///< theirs, on all ranks
  std::vector<int64_t> others;        ///< and all other points', where there are far ones
  std::string warning;                ///< a sentence; empty: there are none
};

FarPoints FindFarPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                        const SceneFrame& frame);

/// A solution that is distorted by far points is not usable. The criteria: at the end, far points
/// cost more than all others, or the others cost more than kMaxNearRise times their cost at the
/// start. Observations behind their cameras at the start or the end are left out. Both criteria
/// apply only if far points pull: the square root of the mean of rho' s over their observations, s
/// the squared residual, exceeds kFarPull pixels, or loss scales (rho' s is the gradient of an
/// observation along its residual). Otherwise, they may have most of a cost that is rounding, or
/// that a loss bounds. A solve without iterations is not judged.
void JudgeFarPoints(const AdjustmentProblem& problem, const FarPoints& far,
                    const SolveOptions& options, SolveOutput* output);

}  // namespace bundle
