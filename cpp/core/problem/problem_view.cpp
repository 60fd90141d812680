#include "core/problem/problem_view.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <sstream>
#include <string>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/error.h"
#include "core/geometry/rotation.h"

namespace bundle {

std::vector<int64_t> TrackLengths(const ProblemView& problem) {
  std::vector<int64_t> lengths(problem.num_points);
  for (int64_t i = 0; i < problem.num_observations; ++i) ++lengths[problem.observation_point[i]];
  return lengths;
}

Tracks GroupByPoint(const ProblemView& problem) {
  const std::vector<int64_t> lengths = TrackLengths(problem);
  Tracks tracks;
  tracks.starts.resize(lengths.size() + 1);
  std::partial_sum(lengths.begin(), lengths.end(), tracks.starts.begin() + 1);
  tracks.images.resize(problem.num_observations);
  std::vector<int64_t> next(tracks.starts.begin(), tracks.starts.end() - 1);
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
  if (repeated != sorted.end()) Fail(what, " ", *repeated, ": expected every id once, found twice");
}

void CheckImages(const ProblemView& problem) {
  for (int i = 0; i < problem.num_images; ++i) {
    const double* pose = problem.cam_from_world + 7 * static_cast<int64_t>(i);
    for (int j = 0; j < 7; ++j) {
      if (!std::isfinite(pose[j])) {
        Fail("image ", problem.image_ids[i], ": expected a finite pose, found ", pose[j]);
      }
    }
    const double norm = QuaternionNorm(pose);
    if (!(norm > 1e-150) || !std::isfinite(norm * norm)) {
      Fail("image ", problem.image_ids[i], ": expected a rotation, found a quaternion of norm ",
           norm);
    }
    const int32_t camera = problem.image_camera[i];
    if (camera < 0 || camera >= problem.num_cameras) {
      Fail("image ", problem.image_ids[i], ": expected a camera index below ", problem.num_cameras,
           ", found ", camera);
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
  CheckCameras(problem);
  CheckPoints(problem);
}

void ValidateProblem(const ProblemView& problem) {
  CheckIdsUnique("image", problem.image_ids, problem.num_images);
  CheckIdsUnique("camera", problem.camera_ids, problem.num_cameras);
  CheckIdsUnique("point", problem.point_ids, problem.num_points);
  ValidateState(problem);
  CheckObservations(problem);
}

namespace {

constexpr const char* kSameStructure = "expected the structure that the solver was made for, ";

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
  CheckSameArray("camera_ids", expected.camera_ids, given.camera_ids, expected.num_cameras);
  CheckSameArray("point_ids", expected.point_ids, given.point_ids, expected.num_points);
  CheckSameArray("observation_image", expected.observation_image, given.observation_image,
                 expected.num_observations);
  CheckSameArray("observation_point", expected.observation_point, given.observation_point,
                 expected.num_observations);
}

}  // namespace bundle
