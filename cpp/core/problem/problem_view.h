#pragma once

/// The arrays of a bundle adjustment problem, validated, and its observations grouped by point.

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/scratch/large_vector.h"

namespace bundle {

struct CameraModel;
/// The arrays of a bundle adjustment problem, row-major and owned by the caller (NumPy, a test).
/// Units are pixels in images; all other lengths are in the reconstruction's unit.
///
/// Readers and the solver use the same struct. The solver never writes through these pointers.
struct ProblemView {
  int num_images = 0;
  int num_cameras = 0;
  int num_points = 0;
  int64_t num_observations = 0;

  const double* cam_from_world = nullptr;  ///< num_images x 7: qx qy qz qw tx ty tz
  const int64_t* image_ids = nullptr;      ///< num_images, for messages
  const int32_t* image_camera = nullptr;   ///< num_images: index of the camera

  /// Rigs of several sensors: an image i with image_frame[i] >= 0 has no pose of its own. Its pose
  /// follows from its sensor and its frame, cam_from_world = sensor_from_rig * rig_from_world.
  /// Without such rigs, there are no frames, no sensors and no arrays for them.
  int num_frames = 0;  ///< a frame is the pose of a rig at one time
  int num_sensors =
      0;  ///< but for their rigs' reference sensors, whose sensor_from_rig is identity
  const double* rig_from_world = nullptr;   ///< num_frames x 7, as cam_from_world
  const double* sensor_from_rig = nullptr;  ///< num_sensors x 7
  const int32_t* image_frame = nullptr;     ///< num_images: index of the frame; -1: no frame
  /// num_images: index of the sensor; -1: the reference sensor, or no frame.
  const int32_t* image_sensor = nullptr;
  const int64_t* frame_ids = nullptr;          ///< num_frames, for messages
  const int64_t* frame_rig_ids = nullptr;      ///< num_frames
  const int64_t* sensor_rig_ids = nullptr;     ///< num_sensors: a sensor is a rig and a camera
  const int64_t* sensor_camera_ids = nullptr;  ///< num_sensors

  const int64_t* camera_ids = nullptr;            ///< num_cameras, for messages
  std::vector<std::string> camera_model_names;    ///< num_cameras
  std::vector<const CameraModel*> camera_models;  ///< num_cameras; nullptr: unknown model
  const double* camera_params = nullptr;          ///< num_cameras x camera_params_stride
  int camera_params_stride = 0;
  const double* points = nullptr;      ///< num_points x 3
  const int64_t* point_ids = nullptr;  ///< num_points, for messages

  const int32_t* observation_image = nullptr;  ///< num_observations
  const int32_t* observation_point = nullptr;  ///< num_observations
  const double* observation_xy = nullptr;      ///< num_observations x 2
  /// num_observations, pixels: sigmas by which a solve divides residuals before the loss; nullptr:
  /// all are 1.
  const double* observation_sigma = nullptr;

  /// Rolling shutters (factors/rolling_shutter.h). `row_scale` is num_cameras x 2, the derivatives
  /// of a row's time s by x and by y; zeros: a global shutter; empty: all shutters are global, and
  /// the arrays below are nullptr.
  std::vector<double> row_scale;
  const double* twists = nullptr;    ///< num_images x 6, per frame height, in the camera's frame
  const double* readouts = nullptr;  ///< num_cameras: share of a frame; NaN: unknown
  /// num_images x 2: images between which the twist is constant; -1: none. nullptr: all none.
  const int32_t* twist_neighbours = nullptr;
  const double* image_frames = nullptr;  ///< num_images: time in frames; nullptr: unknown
  bool at_observed_row = false;          ///< rows are the measured ones

  bool HasRollingShutter(int image) const {
    return !row_scale.empty() && (RowScaleOf(image)[0] != 0 || RowScaleOf(image)[1] != 0);
  }
  const double* RowScaleOf(int image) const {
    return &row_scale[2 * static_cast<size_t>(image_camera[image])];
  }
  const double* TwistOf(int image) const { return twists + 6 * int64_t{image}; }

  const double* ParamsOf(int camera) const {
    return camera_params + static_cast<int64_t>(camera) * camera_params_stride;
  }
  /// The frame of an image; -1: its pose is its own.
  int FrameOf(int image) const { return num_frames == 0 ? -1 : image_frame[image]; }
  /// The sensor of an image; -1: the reference sensor of a rig, or no sensor.
  int SensorOf(int image) const { return num_sensors == 0 ? -1 : image_sensor[image]; }
};

/// Observations grouped by point: those of point p are images[starts[p]] to images[starts[p + 1] -
/// 1], in the order of the problem.
struct Tracks {
  LargeVector<int64_t> starts;  ///< num_points + 1
  LargeVector<int32_t> images;  ///< image per observation
};

Tracks GroupByPoint(const ProblemView& problem);

/// The number of observations of each point.
LargeVector<int64_t> TrackLengths(const ProblemView& problem);

/// Throws InputError unless `given` has the same images, cameras, points and observations as
/// `expected`, on which the layout of a solver depends. Poses, parameters, points and measurements
/// may differ. Arrays with the same address are assumed to be equal.
void CheckSameStructure(const ProblemView& expected, const ProblemView& given);

/// Validates the values that a solve changes: poses of images, frames and sensors, camera
/// parameters and points.
void ValidateState(const ProblemView& problem);

/// Checks the values of a problem whose arrays have the right sizes.
///
/// Throws InputError at the first value that is not finite, index out of range, repeated id, zero
/// quaternion, non-positive focal length, parameter row that is too short, or sensor of another
/// camera, with the id of its owner. Unknown camera models (nullptr) are accepted: a function that
/// needs the model throws.
void ValidateProblem(const ProblemView& problem);

}  // namespace bundle
