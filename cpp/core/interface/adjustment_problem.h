#pragma once

/// Input of a solve: a bundle adjustment problem.

#include <cstdint>
#include <utility>

#include "core/problem/problem_view.h"

namespace bundle {

class Communicator;     // sums/communicator.h
struct ProblemFactors;  // model/problem_factors.h

/// Parts of a pose that Restrictions::held_pose_parts holds constant.
inline constexpr uint8_t kHeldRotation = 1;
inline constexpr uint8_t kHeldPosition = 2;

/// Limits on the unknowns of a problem. Arrays are owned by the caller; nullptr: no such limits.
struct Restrictions {
  /// Bounds of camera_params during refinement, as arrays of the same size. Infinite for a
  /// parameter without bound. A parameter with equal bounds is constant.
  const double* camera_lower = nullptr;
  const double* camera_upper = nullptr;
  /// One mask per camera (num_cameras): bit j is set if the camera's parameter j is constant.
  const uint32_t* held_camera_params = nullptr;
  /// num_images: kHeldRotation, kHeldPosition (the position of the camera's centre) or both.
  const uint8_t* held_pose_parts = nullptr;
  /// Ties: camera parameters that are multiples of a common number. For each entry of
  /// camera_params: the index of the number (-1: not tied), and the factor. The camera_params
  /// satisfy the ties.
  const int32_t* camera_tie = nullptr;
  const double* camera_tie_scale = nullptr;
  int num_ties = 0;
};

/// Division of a problem among ranks (sums/communicator.h). Each rank has a part of the points,
/// with their observations and their factors. Images, frames, sensors, cameras and all other
/// factors are on every rank.
struct RankDivision {
  Communicator* communicator = nullptr;  ///< nullptr: the problem is not divided
  /// num_images: 1 if any rank has an observation of the image. Only with a communicator.
  const uint8_t* image_is_observed = nullptr;
  /// num_points: section of each point in the complete problem (sums/point_sections.h). nullptr:
  /// this rank has all points.
  const uint16_t* point_section = nullptr;
};

/// The arrays of a problem, its restrictions, factors other than observations, and its division.
struct AdjustmentProblem : ProblemView {
  AdjustmentProblem() = default;
  /// A problem without restrictions and factors, on one rank.
  explicit AdjustmentProblem(ProblemView view) : ProblemView(std::move(view)) {}

  Restrictions restrictions;
  const ProblemFactors* factors = nullptr;  ///< nullptr: no factors
  double origin[3] = {};  ///< origin of the arrays' world in the world of the factors
  RankDivision division;
};

}  // namespace bundle
