#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>

#include "core/io/output_file.h"

namespace bundle {

/// What a BAL file can hold, in COLMAP's conventions; arrays owned by somebody else, row-major,
/// units pixels and the reconstruction's length unit. Every image has its own camera.
struct BalView {
  int64_t num_images = 0;
  int64_t num_points = 0;
  int64_t num_observations = 0;
  const double* cam_from_world = nullptr;      ///< num_images x 7: qx qy qz qw tx ty tz
  const double* camera_params = nullptr;       ///< num_images x 5: f cx cy k1 k2
  const double* points = nullptr;              ///< num_points x 3
  const int32_t* observation_image = nullptr;  ///< num_observations
  const int32_t* observation_point = nullptr;  ///< num_observations
  const double* observation_xy = nullptr;      ///< num_observations x 2
  /// num_images x 3, may be null: angle-axis to write in place of the one that cam_from_world
  /// gives, where keeps_rotation is set. The way over a quaternion costs the last bits.
  const double* rotations = nullptr;
  const uint8_t* keeps_rotation = nullptr;  ///< num_images; null only where rotations is
};

/// Writes a BAL file. Numbers are the shortest that read back as the same double. A principal point
/// is subtracted from the observations, since BAL measures from it.
///
/// `on_block` is called between blocks of about a megabyte and may throw. Throws std::system_error.
void WriteBal(const BalView& problem, const std::filesystem::path& path, Compression compression,
              const std::function<void()>& on_block);

}  // namespace bundle
