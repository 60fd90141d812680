#include "core/model/free_parameters.h"

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <set>
#include <string>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/error.h"
#include "core/model/parameter_layout.h"
#include "core/model/problem_factors.h"

namespace bundle {

std::vector<uint8_t> FindObservedImages(const AdjustmentProblem& problem) {
  if (problem.division.image_is_observed != nullptr) {
    return {problem.division.image_is_observed,
            problem.division.image_is_observed + problem.num_images};
  }
  std::vector<uint8_t> observed(problem.num_images);
  for (int64_t i = 0; i < problem.num_observations; ++i) observed[problem.observation_image[i]] = 1;
  return observed;
}

namespace {

/// Calls fix(index) for each id.
template <typename Fix>
void ForEachIndex(const char* what, const std::vector<int64_t>& wanted, const int64_t* ids,
                  int num_ids, const Fix& fix) {
  if (wanted.empty()) return;
  // Both ascend as a rule, and often follow each other: hash tables take ten times as long.
  std::vector<int> order(num_ids);
  std::iota(order.begin(), order.end(), 0);
  const auto before = [ids](int i, int j) { return ids[i] < ids[j]; };
  if (!std::is_sorted(order.begin(), order.end(), before)) {
    std::sort(order.begin(), order.end(), before);
  }
  auto at = order.begin();
  for (const int64_t id : wanted) {
    if (at == order.end() || ids[*at] != id) {
      at = std::lower_bound(order.begin(), order.end(), id,
                            [ids](int i, int64_t value) { return ids[i] < value; });
    }
    if (at == order.end() || ids[*at] != id) {
      throw InputError(std::string("fixed_") + what + "_ids: expected ids in the problem, found " +
                       std::to_string(id));
    }
    fix(*at++);
  }
}

bool IsRefined(CameraParam::Kind kind, const SolveOptions& options) {
  switch (kind) {
    case CameraParam::kFocal:
      return options.refine_focal;
    case CameraParam::kPrincipalPoint:
      return options.refine_principal_point;
    case CameraParam::kExtra:
      return options.refine_extra;
    case CameraParam::kMetadata:
      return false;
  }
  return false;
}

uint32_t FreeCameraParameters(const CameraModel& model, const SolveOptions& options) {
  uint32_t free = 0;
  for (int j = 0; j < model.num_params; ++j) {
    if (IsRefined(model.params[j].kind, options)) free |= 1u << j;
  }
  return free;
}

/// The pose of an image is its own, or follows from its frame and sensor.
void FreePoseOf(const AdjustmentProblem& problem, const SolveOptions& options, int image,
                FreeParameters* free) {
  const int sensor = problem.SensorOf(image);
  if (options.refine_poses) {
    free->OfPose(MovingPose(problem, image)) = FreeParameters::kWholePose;
  }
  if (options.refine_sensor_from_rig && sensor >= 0) {
    free->sensor[sensor] = FreeParameters::kWholePose;
  }
}

void HoldSensorsWithoutReference(const AdjustmentProblem& problem, FreeParameters* free) {
  if (problem.num_sensors == 0) return;
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  std::set<int64_t> rigs;  // rigs whose reference sensor has observations
  for (int i = 0; i < problem.num_images; ++i) {
    const int frame = problem.FrameOf(i);
    if (observed[i] && frame >= 0 && problem.SensorOf(i) < 0) {
      rigs.insert(problem.frame_rig_ids[frame]);
    }
  }
  for (int s = 0; s < problem.num_sensors; ++s) {
    if (rigs.count(problem.sensor_rig_ids[s]) == 0) free->sensor[s] = 0;
  }
}

void HoldSensors(const AdjustmentProblem& problem, const SolveOptions& options,
                 FreeParameters* free) {
  for (const SensorId& id : options.fixed_sensors) {
    int found = 0;
    while (found < problem.num_sensors && (problem.sensor_rig_ids[found] != id.first ||
                                           problem.sensor_camera_ids[found] != id.second)) {
      ++found;
    }
    if (found == problem.num_sensors) {
      throw InputError("fixed_sensors: expected sensors with a sensor_from_rig, found rig " +
                       std::to_string(id.first) + ", camera " + std::to_string(id.second));
    }
    free->sensor[found] = 0;
  }
}

/// Fixing an image fixes its frame; with a refined sensor, the image would still move.
void HoldImage(const AdjustmentProblem& problem, int image, FreeParameters* free) {
  const int sensor = problem.SensorOf(image);
  if (sensor >= 0 && free->sensor[sensor] != 0) {
    throw InputError("fixed_image_ids: expected images that no refined sensor moves, found image " +
                     std::to_string(problem.image_ids[image]) + " on the sensor of rig " +
                     std::to_string(problem.sensor_rig_ids[sensor]) + ", camera " +
                     std::to_string(problem.sensor_camera_ids[sensor]) +
                     "; fix that too (fixed_sensors), or an image of the reference sensor instead");
  }
  free->OfPose(MovingPose(problem, image)) = 0;
}

/// Frees the variables of factors, including those without observations.
void FreeTouched(const AdjustmentProblem& problem, const SolveOptions& options,
                 FreeParameters* free) {
  for (const ProblemVariable& variable : problem.factors->variables) {
    switch (variable.kind) {
      case ProblemVariable::Kind::kImage:
        FreePoseOf(problem, options, variable.index, free);
        break;
      case ProblemVariable::Kind::kFrame:
        if (options.refine_poses) free->frame[variable.index] = FreeParameters::kWholePose;
        break;
      case ProblemVariable::Kind::kSensor:
        if (options.refine_sensor_from_rig) {
          free->sensor[variable.index] = FreeParameters::kWholePose;
        }
        break;
      case ProblemVariable::Kind::kCamera:
        if (problem.camera_models[variable.index] == nullptr) break;
        free->camera[variable.index] =
            FreeCameraParameters(*problem.camera_models[variable.index], options);
        break;
      case ProblemVariable::Kind::kTwist:
        break;  // as its image
      case ProblemVariable::Kind::kReadout:
        free->readout[variable.index] = options.refine_readout ? 1 : 0;
        break;
      case ProblemVariable::Kind::kPoint:
        if (options.refine_points) free->point[variable.index] = 1;
        break;
    }
  }
}

void HoldBetweenEqualBounds(const AdjustmentProblem& problem, FreeParameters* free) {
  if (problem.restrictions.camera_lower == nullptr) return;
  const int num_params = std::min(problem.camera_params_stride, kMaxCameraParams);
  for (int c = 0; c < problem.num_cameras; ++c) {
    const int64_t first = static_cast<int64_t>(c) * problem.camera_params_stride;
    for (int j = 0; j < num_params; ++j) {
      const bool equal = problem.restrictions.camera_lower[first + j] ==
                         problem.restrictions.camera_upper[first + j];
      if (equal) free->camera[c] &= ~(1u << j);
    }
  }
}

void HoldParts(const AdjustmentProblem& problem, FreeParameters* free) {
  constexpr uint8_t kRotation = 0b000111;
  for (int c = 0; problem.restrictions.held_camera_params != nullptr && c < problem.num_cameras;
       ++c) {
    free->camera[c] &= ~problem.restrictions.held_camera_params[c];
  }
  for (int i = 0; problem.restrictions.held_pose_parts != nullptr && i < problem.num_images; ++i) {
    const uint8_t parts = problem.restrictions.held_pose_parts[i];
    // An image of a rig holds its frame constant, like a fixed image.
    uint8_t& bits = free->OfPose(MovingPose(problem, i));
    if (parts == (kHeldRotation | kHeldPosition)) bits = 0;
    if (parts == kHeldRotation) bits = static_cast<uint8_t>(bits & ~kRotation);
    // The translation depends on the rotation (TurnsAboutCentre).
    if (parts == kHeldPosition) bits = static_cast<uint8_t>(bits & kRotation);
  }
}

/// Makes tied parameters free together.
void FreeTied(const AdjustmentProblem& problem, FreeParameters* free) {
  if (problem.restrictions.camera_tie == nullptr) return;
  const int64_t stride = problem.camera_params_stride;
  const int num_params = std::min(problem.camera_params_stride, kMaxCameraParams);
  std::vector<bool> is_free(problem.restrictions.num_ties);
  const auto for_ties = [&](const auto& visit) {
    for (int c = 0; c < problem.num_cameras; ++c) {
      for (int j = 0; j < num_params; ++j) {
        if (const int tie = problem.restrictions.camera_tie[stride * c + j]; tie >= 0)
          visit(c, j, tie);
      }
    }
  };
  for_ties([&](int c, int j, int tie) {
    if (free->camera[c] >> j & 1u) is_free[tie] = true;
  });
  for_ties([&](int c, int j, int tie) {
    if (is_free[tie]) free->camera[c] |= 1u << j;
  });
}

/// A twist is free if its image moves, unless it follows from poses and a readout.
void FreeTwists(const AdjustmentProblem& problem, const SolveOptions& options,
                FreeParameters* free) {
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  for (int i = 0; i < problem.num_images; ++i) {
    if (!problem.HasRollingShutter(i) || !observed[i]) continue;
    if (options.twists != Twists::kHard) {
      free->twist[i] = free->pose[i] != 0 ? 1 : 0;
    } else if (problem.twist_neighbours != nullptr && problem.twist_neighbours[2 * i] >= 0) {
      free->hard_twist[i] = 1;
      if (options.refine_readout) free->readout[problem.image_camera[i]] = 1;
    }
  }
}

}  // namespace

FreeParameters SelectFreeParameters(const AdjustmentProblem& problem, const SolveOptions& options) {
  FreeParameters free;
  free.pose.resize(problem.num_images);
  free.camera.resize(problem.num_cameras);
  free.point.resize(problem.num_points);
  free.frame.resize(problem.num_frames);
  free.sensor.resize(problem.num_sensors);
  free.twist.resize(problem.num_images);
  free.readout.resize(problem.num_cameras);
  free.hard_twist.resize(problem.num_images);
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  for (int i = 0; i < problem.num_images; ++i) {
    if (!observed[i]) continue;
    FreePoseOf(problem, options, i, &free);
    const int camera = problem.image_camera[i];
    free.camera[camera] = FreeCameraParameters(*problem.camera_models[camera], options);
  }
  for (int64_t i = 0; options.refine_points && i < problem.num_observations; ++i) {
    free.point[problem.observation_point[i]] = 1;
  }
  if (problem.factors != nullptr) FreeTouched(problem, options, &free);
  HoldBetweenEqualBounds(problem, &free);
  HoldParts(problem, &free);
  HoldSensorsWithoutReference(problem, &free);
  HoldSensors(problem, options, &free);
  ForEachIndex("camera", options.fixed_camera_ids, problem.camera_ids, problem.num_cameras,
               [&](int index) { free.camera[index] = 0; });
  ForEachIndex("image", options.fixed_image_ids, problem.image_ids, problem.num_images,
               [&](int index) { HoldImage(problem, index, &free); });
  ForEachIndex("point", options.fixed_point_ids, problem.point_ids, problem.num_points,
               [&](int index) { free.point[index] = 0; });
  FreeTied(problem, &free);
  FreeTwists(problem, options, &free);
  return free;
}

}  // namespace bundle
