#pragma once

/// The unit of length in which a scene is solved.
///
/// The scale of the world is free, but solvers depend on it. Ceres damps a column j by clamp(s_j^2
/// c_j, 1e-6, ...) / s_j^2 with c_j = ||J e_j||^2 and s_j = 1 / (1 + sqrt(c_j)). This is
/// proportional to c_j until sqrt(c_j) falls below 1e-3. In a scene of 1e6 units, columns of points
/// are below this limit. Their damping then stays too large, and steps become too short. Also, the
/// parameter tolerance compares a step with all of x, in which large coordinates dominate rotations
/// and small coordinates.
///
/// So a scene whose size is outside of kSmallestWorld to kLargestWorld is solved with all its
/// lengths times a power of two that makes its size about 1. No bit of a mantissa changes in either
/// direction. Factors measure in the unit of the problem: a scene with factors is not scaled, and a
/// warning says so.

#include <string>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/summary.h"
#include "core/model/scene_frame.h"
#include "core/scratch/large_vector.h"

namespace bundle {

inline constexpr double kSmallestWorld = 1e-3;
inline constexpr double kLargestWorld = 1e5;

/// A problem in such a unit, or the problem itself if it needs no scaling.
class ScaledProblem {
 public:
  explicit ScaledProblem(const AdjustmentProblem& problem);
  ScaledProblem(const ScaledProblem&) = delete;
  ScaledProblem& operator=(const ScaledProblem&) = delete;

  const AdjustmentProblem& view() const { return scaled_; }
  /// Frame of view(); its unit is in lengths of the problem.
  const SceneFrame& frame() const { return frame_; }
  /// Reason why an extreme scene is not scaled; "" if it is scaled, or not extreme.
  const std::string& warning() const { return warning_; }

  /// Converts a solution of view() to the unit of the problem.
  void ScaleBack(SolveOutput* output) const;

 private:
  std::vector<double> cam_from_world_, rig_from_world_, sensor_from_rig_, twists_;
  LargeVector<double> points_;
  AdjustmentProblem scaled_;
  SceneFrame frame_;
  std::string warning_;
};

}  // namespace bundle
