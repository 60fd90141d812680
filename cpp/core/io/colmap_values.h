#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "core/cameras/camera_model.h"
#include "core/io/model_file.h"

namespace bundle {

/// nullptr where COLMAP 4.2 has no such model. Our models stand in the order of COLMAP's ids.
const CameraModel* FindColmapCameraModel(int32_t id);

// Checks of single values, the same in both formats. Each throws InputError at `position`;
// `subject` is "camera 3".

/// Parameters finite, focal lengths and image sizes above zero.
void CheckCameraParams(const ModelFile& file, uint64_t position, const std::string& subject,
                       const CameraModel& model, const double* params);

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
