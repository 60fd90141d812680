#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "core/io/model_file.h"

namespace bundle {

/// What a file must say of a camera model; COLMAP's sensor/models.h has the rest.
struct ColmapCameraModel {
  int32_t id;
  std::string_view name;
  int num_params;
  int num_focal_lengths;  ///< they are the first parameters
};

/// nullptr where COLMAP 4.2 has no such model.
const ColmapCameraModel* FindColmapCameraModel(std::string_view name);
const ColmapCameraModel* FindColmapCameraModel(int32_t id);

/// Longest list of parameters of any model.
constexpr int kMaxColmapCameraParams = 16;

// Checks of single values, the same in both formats. Each throws InputError at `position`;
// `subject` is "camera 3".

/// Parameters finite, focal lengths above zero.
void CheckCameraParams(const ModelFile& file, uint64_t position, const std::string& subject,
                       const ColmapCameraModel& model, const double* params);

/// `pose` is qw qx qy qz tx ty tz, as in the files: finite, with a quaternion that gives a
/// rotation.
void CheckPose(const ModelFile& file, uint64_t position, const std::string& subject,
               const double* pose);

/// Image sizes must fit our signed 64-bit numbers.
void CheckCameraSize(const ModelFile& file, uint64_t position, const std::string& subject,
                     uint64_t width, uint64_t height);

/// An image name is UTF-8 without control characters: what pycolmap can hand to Python.
void CheckImageName(const ModelFile& file, uint64_t position, const std::string& subject,
                    std::string_view name);

/// The shortest decimal number that reads back as `value`.
std::string FormatNumber(double value);

}  // namespace bundle
