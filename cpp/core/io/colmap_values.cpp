#include "core/io/colmap_values.h"

#include <charconv>
#include <cmath>
#include <limits>

#include "core/io/printable.h"

namespace bundle {
namespace {

constexpr ColmapCameraModel kModels[] = {
    {0, "SIMPLE_PINHOLE", 3, 1},
    {1, "PINHOLE", 4, 2},
    {2, "SIMPLE_RADIAL", 4, 1},
    {3, "RADIAL", 5, 1},
    {4, "OPENCV", 8, 2},
    {5, "OPENCV_FISHEYE", 8, 2},
    {6, "FULL_OPENCV", 12, 2},
    {7, "FOV", 5, 2},
    {8, "SIMPLE_RADIAL_FISHEYE", 4, 1},
    {9, "RADIAL_FISHEYE", 5, 1},
    {10, "THIN_PRISM_FISHEYE", 12, 2},
    {11, "RAD_TAN_THIN_PRISM_FISHEYE", 16, 2},
    {12, "SIMPLE_DIVISION", 4, 1},
    {13, "DIVISION", 5, 2},
    {14, "SIMPLE_FISHEYE", 3, 1},
    {15, "FISHEYE", 4, 2},
    {16, "EUCM", 6, 2},
    {17, "EQUIRECTANGULAR", 2, 0},
};

}  // namespace

const ColmapCameraModel* FindColmapCameraModel(std::string_view name) {
  for (const ColmapCameraModel& model : kModels) {
    if (model.name == name) return &model;
  }
  return nullptr;
}

const ColmapCameraModel* FindColmapCameraModel(int32_t id) {
  for (const ColmapCameraModel& model : kModels) {
    if (model.id == id) return &model;
  }
  return nullptr;
}

void CheckCameraParams(const ModelFile& file, uint64_t position, const std::string& subject,
                       const ColmapCameraModel& model, const double* params) {
  for (int i = 0; i < model.num_params; ++i) {
    const bool is_focal_length = i < model.num_focal_lengths;
    if (std::isfinite(params[i]) && (!is_focal_length || params[i] > 0.0)) continue;
    file.Fail(position, subject + ": expected " +
                            (is_focal_length ? "a focal length above 0" : "a finite number") +
                            " as parameter " + std::to_string(i) + " of " +
                            std::string(model.name) + ", found " + FormatNumber(params[i]));
  }
}

void CheckPose(const ModelFile& file, uint64_t position, const std::string& subject,
               const double* pose) {
  for (int i = 0; i < 7; ++i) {
    if (!std::isfinite(pose[i])) {
      file.Fail(position, subject + ": expected a finite pose, found " + FormatNumber(pose[i]));
    }
  }
  const double squared_norm =
      pose[0] * pose[0] + pose[1] * pose[1] + pose[2] * pose[2] + pose[3] * pose[3];
  if (!(squared_norm > 0.0) || !std::isfinite(squared_norm)) {
    file.Fail(position, subject + ": expected a quaternion of norm 1, found norm " +
                            FormatNumber(std::hypot(std::hypot(pose[0], pose[1]),
                                                    std::hypot(pose[2], pose[3]))));
  }
}

void CheckCameraSize(const ModelFile& file, uint64_t position, const std::string& subject,
                     uint64_t width, uint64_t height) {
  constexpr uint64_t kMaxSize = std::numeric_limits<int64_t>::max();
  if (width <= kMaxSize && height <= kMaxSize) return;
  file.Fail(position, subject + ": expected an image size below 2^63, found " +
                          std::to_string(width) + " x " + std::to_string(height));
}

void CheckImageName(const ModelFile& file, uint64_t position, const std::string& subject,
                    std::string_view name) {
  if (Printable(name) == name) return;
  file.Fail(position, subject + ": expected a name in UTF-8 without control characters, found " +
                          Quoted(name));
}

std::string FormatNumber(double value) {
  char text[32];
  const auto [end, error] = std::to_chars(text, text + sizeof(text), value);
  return error == std::errc() ? std::string(text, end) : "?";
}

}  // namespace bundle
