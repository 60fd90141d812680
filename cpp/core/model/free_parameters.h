#pragma once

/// Free parameters: the numbers of a problem that a solve may change.

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"

namespace bundle {

/// Bit j of a pose: entry j of (w, t) (factors/reprojection.h). Bit j of a camera: parameter j.
struct FreeParameters {
  static constexpr uint8_t kWholePose = 0b111111;
  /// Free, but not eliminated: it has a block of the layout (ReducedSystem).
  static constexpr uint8_t kKeptPoint = 2;

  std::vector<uint8_t> pose;  ///< num_images; 0 for images of rigs, whose poses are not their own
  std::vector<uint32_t> camera;  ///< num_cameras
  std::vector<uint8_t> point;    ///< num_points: 0, 1, or kKeptPoint
  std::vector<uint8_t> frame;    ///< num_frames: of rig_from_world
  std::vector<uint8_t> sensor;   ///< num_sensors: of sensor_from_rig
  std::vector<uint8_t> twist;    ///< num_images: 1 if it moves with the pose of its image
  std::vector<uint8_t> readout;  ///< num_cameras: 0 or 1
  /// num_images: 1 if the twist follows from the poses of its neighbours and the readout
  std::vector<uint8_t> hard_twist;

  /// Bits of the pose with this number (NumPoses): of an image's own pose, a frame or a sensor.
  uint8_t& OfPose(int number) {
    size_t k = number;
    for (std::vector<uint8_t>* bits : {&pose, &frame}) {
      if (k < bits->size()) return (*bits)[k];
      k -= bits->size();
    }
    return sensor[k];
  }

  bool operator==(const FreeParameters& other) const {
    return pose == other.pose && camera == other.camera && point == other.point &&
           frame == other.frame && sensor == other.sensor && twist == other.twist &&
           readout == other.readout && hard_twist == other.hard_twist;
  }
};

/// Per image: 1 if it has observations.
std::vector<uint8_t> FindObservedImages(const AdjustmentProblem& problem);

/// Selects the parameters that the options leave free and that occur in an observation or a factor.
/// A fixed image fixes its frame. The sensors of a rig whose reference sensor observes nothing are
/// fixed, because moving all of them on the rig is equivalent to moving its frames. Throws
/// InputError if an id to be fixed is not in the problem.
FreeParameters SelectFreeParameters(const AdjustmentProblem& problem, const SolveOptions& options);

}  // namespace bundle
