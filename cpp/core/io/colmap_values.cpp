#include "core/io/colmap_values.h"

#include <charconv>
#include <cmath>
#include <limits>

#include "core/cameras/registry.h"
#include "core/io/printable.h"

namespace bundle {

const CameraModel* FindColmapCameraModel(int32_t id) {
  return id >= 0 && id < kNumCameraModels ? AllCameraModels() + id : nullptr;
}

void CheckCameraParams(const ModelFile& file, uint64_t position, const std::string& subject,
                       const CameraModel& model, const double* params) {
  for (int i = 0; i < model.num_params; ++i) {
    const CameraParam::Kind kind = model.params[i].kind;
    const bool is_positive = kind == CameraParam::kFocal || kind == CameraParam::kMetadata;
    if (std::isfinite(params[i]) && (!is_positive || params[i] > 0.0)) continue;
    const std::string expected = kind == CameraParam::kFocal      ? "a focal length above 0"
                                 : kind == CameraParam::kMetadata ? "an image size above 0"
                                                                  : "a finite number";
    file.Fail(position, subject + ": expected " + expected + " as parameter " + std::to_string(i) +
                            " of " + model.name + ", found " + FormatNumber(params[i]));
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
