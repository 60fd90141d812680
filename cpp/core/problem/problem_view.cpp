#include "core/problem/problem_view.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/error.h"
#include "core/geometry/rotation.h"

namespace bundle {

LargeVector<int64_t> TrackLengths(const ProblemView& problem) {
  LargeVector<int64_t> lengths(problem.num_points, 0);
  for (int64_t i = 0; i < problem.num_observations; ++i) ++lengths[problem.observation_point[i]];
  return lengths;
}

Tracks GroupByPoint(const ProblemView& problem) {
  const LargeVector<int64_t> lengths = TrackLengths(problem);
  Tracks tracks;
  tracks.starts.resize(lengths.size() + 1, 0);
  std::partial_sum(lengths.begin(), lengths.end(), tracks.starts.begin() + 1);
  tracks.images.resize(problem.num_observations);
  LargeVector<int64_t> next(tracks.starts.begin(), tracks.starts.end() - 1);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    tracks.images[next[problem.observation_point[i]]++] = problem.observation_image[i];
  }
  return tracks;
}

namespace {

template <typename... Parts>
[[noreturn]] void Fail(const Parts&... parts) {
  std::ostringstream message;
  (message << ... << parts);
  throw InputError(message.str());
}

void CheckIdsUnique(const char* what, const int64_t* ids, int count) {
  if (std::is_sorted(ids, ids + count, std::less_equal<>())) return;
  std::vector<int64_t> sorted(ids, ids + count);
  std::sort(sorted.begin(), sorted.end());
  const auto repeated = std::adjacent_find(sorted.begin(), sorted.end());
  if (repeated != sorted.end())
    Fail(what, " ", *repeated, ": expected unique ids, found this id twice");
}

template <typename... Name>
void CheckPose(const double* pose, const Name&... name) {
  for (int j = 0; j < 7; ++j) {
    if (!std::isfinite(pose[j])) Fail(name..., ": expected a finite pose, found ", pose[j]);
  }
  const double norm = QuaternionNorm(pose);
  if (!(norm > 1e-150) || !std::isfinite(norm * norm)) {
    Fail(name..., ": expected a rotation, found a quaternion of norm ", norm);
  }
}

void CheckImages(const ProblemView& problem) {
  for (int i = 0; i < problem.num_images; ++i) {
    CheckPose(problem.cam_from_world + 7 * static_cast<int64_t>(i), "image ", problem.image_ids[i]);
    const int32_t camera = problem.image_camera[i];
    if (camera < 0 || camera >= problem.num_cameras) {
      Fail("image ", problem.image_ids[i], ": expected a camera index below ", problem.num_cameras,
           ", found ", camera);
    }
  }
}

void CheckRigPoses(const ProblemView& problem) {
  for (int f = 0; f < problem.num_frames; ++f) {
    CheckPose(problem.rig_from_world + 7 * static_cast<int64_t>(f), "frame ", problem.frame_ids[f]);
  }
  for (int s = 0; s < problem.num_sensors; ++s) {
    CheckPose(problem.sensor_from_rig + 7 * static_cast<int64_t>(s), "sensor_from_rig: rig ",
              problem.sensor_rig_ids[s], ", camera ", problem.sensor_camera_ids[s]);
  }
}

void CheckSensorIds(const ProblemView& problem) {
  std::set<std::pair<int64_t, int64_t>> sensors;
  for (int s = 0; s < problem.num_sensors; ++s) {
    const auto sensor = std::make_pair(problem.sensor_rig_ids[s], problem.sensor_camera_ids[s]);
    if (sensors.insert(sensor).second) continue;
    Fail("sensor_from_rig: rig ", sensor.first, ", camera ", sensor.second,
         ": expected every sensor once, found twice");
  }
}

/// Checks that the frame and the sensor of each image are in range and match its camera.
void CheckRigImages(const ProblemView& problem) {
  for (int i = 0; i < problem.num_images; ++i) {
    const int32_t frame = problem.num_frames == 0 ? -1 : problem.image_frame[i];
    const int32_t sensor = problem.num_sensors == 0 ? -1 : problem.image_sensor[i];
    const int64_t id = problem.image_ids[i];
    if (frame < -1 || frame >= problem.num_frames) {
      Fail("image ", id, ": expected a frame index from -1 to ", problem.num_frames - 1, ", found ",
           frame);
    }
    if (sensor < -1 || sensor >= problem.num_sensors) {
      Fail("image ", id, ": expected a sensor index from -1 to ", problem.num_sensors - 1,
           ", found ", sensor);
    }
    if (sensor < 0) continue;
    if (frame < 0) Fail("image ", id, ": expected a frame for its sensor, found ", frame);
    const int64_t camera = problem.camera_ids[problem.image_camera[i]];
    if (camera != problem.sensor_camera_ids[sensor]) {
      Fail("image ", id, ": expected camera ", problem.sensor_camera_ids[sensor],
           " of its sensor, found camera ", camera);
    }
  }
}

void CheckCameras(const ProblemView& problem) {
  for (int c = 0; c < problem.num_cameras; ++c) {
    const CameraModel* model = problem.camera_models[c];
    const double* params = problem.ParamsOf(c);
    if (model == nullptr) continue;
    if (problem.camera_params_stride < model->num_params) {
      Fail("camera ", problem.camera_ids[c], ": expected ", model->num_params, " parameters of ",
           model->name, ", found ", problem.camera_params_stride);
    }
    for (int j = 0; j < model->num_params; ++j) {
      if (!std::isfinite(params[j])) {
        Fail("camera ", problem.camera_ids[c], ": expected a finite ", model->params[j].name,
             ", found ", params[j]);
      }
      const CameraParam::Kind kind = model->params[j].kind;
      const bool is_focal = kind == CameraParam::kFocal;
      if ((is_focal || kind == CameraParam::kMetadata) && !(params[j] > 0)) {
        Fail("camera ", problem.camera_ids[c], ": expected a positive ",
             is_focal ? "focal length " : "image size ", model->params[j].name, ", found ",
             params[j]);
      }
    }
  }
}

void CheckPoints(const ProblemView& problem) {
  for (int p = 0; p < problem.num_points; ++p) {
    const double* point = problem.points + 3 * static_cast<int64_t>(p);
    for (int j = 0; j < 3; ++j) {
      if (!std::isfinite(point[j])) {
        Fail("point ", problem.point_ids[p], ": expected finite coordinates, found ", point[j]);
      }
    }
  }
}

void CheckObservations(const ProblemView& problem) {
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    const int32_t image = problem.observation_image[i];
    const int32_t point = problem.observation_point[i];
    if (image < 0 || image >= problem.num_images) {
      Fail("observation ", i, ": expected an image index below ", problem.num_images, ", found ",
           image);
    }
    if (point < 0 || point >= problem.num_points) {
      Fail("observation ", i, ": expected a point index below ", problem.num_points, ", found ",
           point);
    }
    const double* xy = problem.observation_xy + 2 * i;
    if (!std::isfinite(xy[0]) || !std::isfinite(xy[1])) {
      Fail("observation ", i, " (image ", problem.image_ids[image], ", point ",
           problem.point_ids[point], "): expected finite pixels, found ", xy[0], " ", xy[1]);
    }
    if (problem.observation_sigma == nullptr) continue;
    const double sigma = problem.observation_sigma[i];
    if (!(sigma > 0) || !std::isfinite(sigma) || !std::isfinite(1 / sigma)) {
      Fail("observation_sigma: observation ", i, " (image ", problem.image_ids[image], ", point ",
           problem.point_ids[point], "): expected a finite sigma above 0, in pixels, found ",
           sigma);
    }
  }
}

}  // namespace

void ValidateState(const ProblemView& problem) {
  CheckImages(problem);
  CheckRigPoses(problem);
  CheckCameras(problem);
  CheckPoints(problem);
}

void ValidateProblem(const ProblemView& problem) {
  CheckIdsUnique("image", problem.image_ids, problem.num_images);
  CheckIdsUnique("camera", problem.camera_ids, problem.num_cameras);
  CheckIdsUnique("point", problem.point_ids, problem.num_points);
  CheckIdsUnique("frame", problem.frame_ids, problem.num_frames);
  CheckSensorIds(problem);
  ValidateState(problem);
  CheckRigImages(problem);
  CheckObservations(problem);
}

namespace {

constexpr const char* kSameStructure = "expected the structure of the solver, ";

void CheckSameCount(const char* name, int64_t expected, int64_t found) {
  if (expected == found) return;
  Fail(name, ": ", kSameStructure, expected, " entries, found ", found);
}

template <typename T>
void CheckSameArray(const char* name, const T* expected, const T* found, int64_t size) {
  if (expected == found) return;
  const auto [a, b] = std::mismatch(expected, expected + size, found);
  if (a == expected + size) return;
  Fail(name, ": ", kSameStructure, *a, " at index ", a - expected, ", found ", *b);
}

}  // namespace

void CheckSameStructure(const ProblemView& expected, const ProblemView& given) {
  CheckSameCount("cam_from_world", expected.num_images, given.num_images);
  CheckSameCount("camera_params", expected.num_cameras, given.num_cameras);
  CheckSameCount("points", expected.num_points, given.num_points);
  CheckSameCount("observation_xy", expected.num_observations, given.num_observations);
  if (expected.camera_params_stride != given.camera_params_stride) {
    Fail("camera_params: ", kSameStructure, "rows of ", expected.camera_params_stride, ", found ",
         given.camera_params_stride);
  }
  CheckSameArray("camera_models", expected.camera_model_names.data(),
                 given.camera_model_names.data(), expected.num_cameras);
  CheckSameArray("image_ids", expected.image_ids, given.image_ids, expected.num_images);
  CheckSameArray("image_camera", expected.image_camera, given.image_camera, expected.num_images);
  CheckSameCount("rig_from_world", expected.num_frames, given.num_frames);
  CheckSameCount("sensor_from_rig", expected.num_sensors, given.num_sensors);
  if (expected.num_frames > 0) {
    CheckSameArray("image_frame", expected.image_frame, given.image_frame, expected.num_images);
    CheckSameArray("frame_rig_ids", expected.frame_rig_ids, given.frame_rig_ids,
                   expected.num_frames);
    CheckSameArray("frame_ids", expected.frame_ids, given.frame_ids, expected.num_frames);
  }
  if (expected.num_sensors > 0) {
    CheckSameArray("image_sensor", expected.image_sensor, given.image_sensor, expected.num_images);
    CheckSameArray("sensor_rig_ids", expected.sensor_rig_ids, given.sensor_rig_ids,
                   expected.num_sensors);
    CheckSameArray("sensor_camera_ids", expected.sensor_camera_ids, given.sensor_camera_ids,
                   expected.num_sensors);
  }
  CheckSameCount("rolling_shutter", static_cast<int64_t>(expected.row_scale.size()),
                 static_cast<int64_t>(given.row_scale.size()));
  CheckSameArray("rolling_shutter", expected.row_scale.data(), given.row_scale.data(),
                 static_cast<int64_t>(expected.row_scale.size()));
  CheckSameArray("camera_ids", expected.camera_ids, given.camera_ids, expected.num_cameras);
  CheckSameArray("point_ids", expected.point_ids, given.point_ids, expected.num_points);
  CheckSameArray("observation_image", expected.observation_image, given.observation_image,
                 expected.num_observations);
  CheckSameArray("observation_point", expected.observation_point, given.observation_point,
                 expected.num_observations);
}

}  // namespace bundle
