#pragma once

/// Which numbers of a problem a solve may change.

#include <cstdint>
#include <vector>

#include "core/problem/problem_view.h"
#include "core/solve/options.h"

namespace bundle {

/// Bit j of a pose: entry j of (w, t) (residuals/reprojection.h). Bit j of a camera: parameter j.
struct FreeParameters {
  static constexpr uint8_t kWholePose = 0b111111;

  std::vector<uint8_t> pose;     ///< num_images
  std::vector<uint32_t> camera;  ///< num_cameras
  std::vector<uint8_t> point;    ///< num_points: 0 or 1
};

/// What the options leave free. Nothing is free that no observation sees. Throws InputError if an
/// id to be fixed is not in the problem.
FreeParameters SelectFreeParameters(const ProblemView& problem, const SolveOptions& options);

}  // namespace bundle
