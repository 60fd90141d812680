#pragma once

/// A bundle adjustment problem as a solve takes it.

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
  /// Bounds of camera_params while they are refined, as many numbers each. Infinite where a
  /// parameter has no bound. A parameter with equal bounds is constant.
  const double* camera_lower = nullptr;
  const double* camera_upper = nullptr;
  /// num_cameras: bit j of a camera is set if its parameter j is constant.
  const uint32_t* held_camera_params = nullptr;
  /// num_images: kHeldRotation, kHeldPosition (the position of the camera's centre) or both.
  const uint8_t* held_pose_parts = nullptr;
  /// Ties: camera parameters that are multiples of one number. As many entries as camera_params:
  /// the index of the number (-1: none), and the factor. The camera_params are such multiples.
  const int32_t* camera_tie = nullptr;
  const double* camera_tie_scale = nullptr;
  int num_ties = 0;
};

/// Division of a problem among ranks (sums/communicator.h). Each rank has a part of the points,
/// with their observations and their factors. Images, frames, sensors, cameras and all other
/// factors are those of the whole problem.
struct RankDivision {
  Communicator* communicator = nullptr;  ///< nullptr: the problem is not divided
  /// num_images: 1 if any rank has an observation of the image. Only with a communicator.
  const uint8_t* image_is_observed = nullptr;
  /// num_points: section of each point among those of the whole problem (sums/point_sections.h).
  /// nullptr: these are all points.
  const uint16_t* point_section = nullptr;
};

/// The arrays of a problem, restrictions, factors beside the observations, and its division.
struct AdjustmentProblem : ProblemView {
  AdjustmentProblem() = default;
  /// A problem without restrictions and factors, on one rank.
  explicit AdjustmentProblem(ProblemView view) : ProblemView(std::move(view)) {}

  Restrictions restrictions;
  const ProblemFactors* factors = nullptr;  ///< nullptr: none
  double origin[3] = {};  ///< origin of the arrays' world in the world of the factors
  RankDivision division;
};

}  // namespace bundle
