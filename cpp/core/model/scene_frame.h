#pragma once

/// Scenes that are far from their origin, and points that are far from their scene.
///
/// Both harm a solver. A rotation turns the world about its origin. If the origin is far away, a
/// rotation of a camera moves it by far more than the size of the scene, and its translation has to
/// compensate. Neither damping nor rounding is suited to that. And the parameter tolerance stops a
/// solve once ||step|| <= tolerance ||x||, where one large coordinate makes every step look small.
///
/// So a scene that is more than kFarOrigin times its size away from the origin (UTM coordinates,
/// for instance) is solved about a point c at its centre. With X' = X - c and t' = t + R c, R X' +
/// t' = R X + t: no residual changes. The solution is moved back; unchanged values keep their bits.
///
/// Points more than kFarPoint sizes away from the centre stay in the problem, but not in the norm:
/// the tolerance is multiplied by ||x without them|| / ||x||.
///
/// The centre is the median of the images' projection centres, coordinate by coordinate; the size
/// is the median distance of some thousand points from it.
///
/// The scene is solved about the point that COLMAP's normalisation puts at the origin: per
/// coordinate, the mean of the projection centres between their 10th and 90th percentile. Damping
/// depends on the origin, and therefore also the number of steps in a slow valley until the
/// function tolerance stops the solve. With this choice, a COLMAP model that was moved takes the
/// same steps as before. If more than a tenth of the images are far away from the others, the
/// origin is the centre instead.

#include <cstdint>
#include <string>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/summary.h"
#include "core/model/parameter_layout.h"
#include "core/scratch/large_vector.h"

namespace bundle {

inline constexpr double kFarOrigin = 100;
inline constexpr double kFarPoint = 1000;
inline constexpr double kMaxNearRise = 2;
inline constexpr double kFarPull = 1;

struct SceneFrame {
  double center[3] = {};
  double origin[3] = {};  ///< solve about this point if it is far from the problem's origin
  double size = 0;        ///< 0 without images or points
  double reach = 0;       ///< distance of the farthest point
  double unit = 1;        ///< in lengths of the user's problem (world_scale.h)

  explicit SceneFrame(const AdjustmentProblem& problem);

  bool IsFarFromOrigin() const;
  double DistanceTo(const double* point) const;
};

/// A problem about the centre of its scene if its origin is far away, or the problem itself.
class CenteredProblem {
 public:
  /// Keeps a reference to the problem.
  CenteredProblem(const AdjustmentProblem& problem, const SceneFrame& frame);
  CenteredProblem(const CenteredProblem&) = delete;
  CenteredProblem& operator=(const CenteredProblem&) = delete;

  const AdjustmentProblem& view() const { return centered_; }
  bool is_moved() const { return !points_.empty(); }

  /// Moves a solution of view() back to the problem's origin.
  void MoveBack(SolveOutput* output) const;

 private:
  const AdjustmentProblem& problem_;
  const SceneFrame& frame_;
  std::vector<double> cam_from_world_;
  std::vector<double> rig_from_world_;
  LargeVector<double> points_;
  AdjustmentProblem centered_;
};

/// The points that are far from the scene and take part in the solve: they have observations with
/// free parameters.
struct FarPoints {
  double norm_without = 1;            ///< ||x without them|| / ||x|| at the start, over all free x
  std::vector<int64_t> observations;  ///< their observations, if these have free parameters
  int64_t num_observations = 0;       ///< number of their observations on all ranks
  std::vector<int64_t> others;        ///< observations of all other points, if there are far points
  std::string warning;                ///< a message; empty without far points
};

FarPoints FindFarPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                        const SceneFrame& frame);

/// A solution that is distorted by far points is not usable. The criteria: at the end, far points
/// cost more than all others, or the others cost more than kMaxNearRise times their cost at the
/// start. Observations behind their cameras at the start or the end are left out. Both criteria
/// apply only if far points pull. Their pull is the square root of the mean of rho' s over their
/// observations, with s the squared residual; it must exceed kFarPull pixels or loss scales.
/// Without this condition, far points could have most of a cost that consists of rounding errors or
/// is bounded by a loss. A solve without iterations is not judged.
void JudgeFarPoints(const AdjustmentProblem& problem, const FarPoints& far,
                    const SolveOptions& options, SolveOutput* output);

}  // namespace bundle
