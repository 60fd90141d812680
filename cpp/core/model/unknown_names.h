#pragma once

/// Names of the unknowns of a layout, for messages and for programs.

#include <cstdint>
#include <string>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// An unknown of a layout: an entry of (w, t) of a pose, a parameter of a camera, an entry of the
/// twist of an image, the readout of a camera, or a coordinate of a point that is not eliminated. A
/// number that several cameras share has the name of the first of these cameras.
struct UnknownName {
  enum Kind : int32_t { kImage, kFrame, kSensor, kCamera, kTwist, kReadout, kPoint };
  int32_t kind = kImage;
  int32_t index = 0;       ///< index of the image, frame, sensor, camera or point
  int32_t coordinate = 0;  ///< 0..5 of a pose or twist, 0..2 of a point, or a camera's parameter
};

/// One name per unknown of the layout.
std::vector<UnknownName> NameUnknowns(const AdjustmentProblem& problem,
                                      const ParameterLayout& layout);

/// "rotation z of image 362", "k of camera 3", with the ids of the problem, which must have ids.
std::string Words(const AdjustmentProblem& problem, const UnknownName& name);

}  // namespace bundle
