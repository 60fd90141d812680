#pragma once

/// The arrays of a bundle adjustment problem, validated, and its observations grouped by point.

#include <cstdint>
#include <string>
#include <vector>

namespace bundle {

struct CameraModel;
struct ProblemFactors;  // model/problem_factors.h

/// The arrays of a bundle adjustment problem, owned by the caller (NumPy, a test), row-major.
/// Units are pixels for everything in an image and the reconstruction's length unit elsewhere.
///
/// One struct serves readers and the solver: it never writes through these pointers.
struct ProblemView {
  int num_images = 0;
  int num_cameras = 0;
  int num_points = 0;
  int64_t num_observations = 0;

  const double* cam_from_world = nullptr;  ///< num_images x 7: qx qy qz qw tx ty tz
  const int64_t* image_ids = nullptr;      ///< num_images, for messages
  const int32_t* image_camera = nullptr;   ///< num_images: index of the camera

  const int64_t* camera_ids = nullptr;            ///< num_cameras, for messages
  std::vector<std::string> camera_model_names;    ///< num_cameras
  std::vector<const CameraModel*> camera_models;  ///< num_cameras; nullptr: a model we do not know
  const double* camera_params = nullptr;          ///< num_cameras x camera_params_stride
  int camera_params_stride = 0;
  /// Bounds of camera_params while they are refined, as many numbers each; nullptr: there are none.
  /// Infinite where a parameter has none; a parameter with equal bounds is held.
  const double* camera_lower = nullptr;
  const double* camera_upper = nullptr;

  const double* points = nullptr;      ///< num_points x 3
  const int64_t* point_ids = nullptr;  ///< num_points, for messages

  const int32_t* observation_image = nullptr;  ///< num_observations
  const int32_t* observation_point = nullptr;  ///< num_observations
  const double* observation_xy = nullptr;      ///< num_observations x 2
  /// num_observations, pixels: what a solve divides residuals by before the loss; nullptr: 1 each.
  const double* observation_sigma = nullptr;

  const ProblemFactors* factors = nullptr;  ///< beside the observations; nullptr: none
  /// The origin of these arrays' world in that of the factors.
  double origin[3] = {};

  const double* ParamsOf(int camera) const {
    return camera_params + static_cast<int64_t>(camera) * camera_params_stride;
  }
};

/// Observations grouped by point: those of point p are in images[starts[p]] to images[starts[p + 1]
/// - 1], in the order of the problem.
struct Tracks {
  std::vector<int64_t> starts;  ///< num_points + 1
  std::vector<int32_t> images;  ///< of each observation
};

Tracks GroupByPoint(const ProblemView& problem);

/// The number of observations of each point.
std::vector<int64_t> TrackLengths(const ProblemView& problem);

/// Throws InputError unless `given` has the same images, cameras, points and observations as
/// `expected`: all that a solver is laid out for. Poses, parameters, points and measurements may
/// differ. Arrays at the same place are taken for equal.
void CheckSameStructure(const ProblemView& expected, const ProblemView& given);

/// Checks what a solve changes: poses, camera parameters and points, as ValidateProblem does.
void ValidateState(const ProblemView& problem);

/// Checks the values of a problem whose arrays have the right sizes.
///
/// Throws InputError at the first value that is not finite, index out of range, repeated id, zero
/// quaternion, non-positive focal length or parameter row that is too short, naming what has it by
/// its id. Unknown camera models (nullptr) pass: a function that needs the model throws.
void ValidateProblem(const ProblemView& problem);

}  // namespace bundle
