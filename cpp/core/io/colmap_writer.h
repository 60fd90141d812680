#pragma once

/// COLMAP models written with refined values.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <vector>

#include "core/io/colmap_model.h"

namespace bundle {

/// The numbers that a solve changes, one row per record in the order of the ids.
struct ColmapValues {
  const double* cam_from_world = nullptr;   ///< (num_images, 7) qx qy qz qw tx ty tz
  const double* rig_from_world = nullptr;   ///< (frames of ColmapRigs, 7)
  const double* sensor_from_rig = nullptr;  ///< (sensors of ColmapRigs, 7)
  const double* camera_params = nullptr;    ///< (num_cameras, params_width)
  size_t params_width = 0;
  size_t num_points = 0;
  const int64_t* point_ids = nullptr;    ///< (num_points,) ascending
  const double* points = nullptr;        ///< (num_points, 3)
  const double* point_errors = nullptr;  ///< (num_points,) mean reprojection error in pixels
};

/// Writes the files of a model that ReadColmapModel has read, or of which ReadColmapPart has read a
/// part, into an existing folder, in the format in which it was read. `values` has all points.
///
/// All bytes except the given numbers are those of the files that were read: keypoints, tracks,
/// colours, rigs, comments. A model without rigs and frames, from older versions, gets them as in
/// COLMAP: one rig per camera and one frame per image, with the same ids. Numbers in text are the
/// shortest that read back as the same value.
///
/// Throws InputError if a file that is not in memory has changed since it was read, and
/// std::system_error for errors of the system.
void WriteColmapModel(const ColmapModel& model, const ColmapValues& values,
                      const std::filesystem::path& folder);

}  // namespace bundle
