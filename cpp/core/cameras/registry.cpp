#include "core/cameras/registry.h"

#include <array>
#include <cstddef>
#include <iterator>

namespace bundle {
namespace {

template <typename... Models>
constexpr std::array<CameraModel, sizeof...(Models)> Describe(std::tuple<Models...>) {
  static_assert(((std::size(Models::kParams) <= kMaxCameraParams) && ...));
  return {{{Models::kName, Models::kParams, static_cast<int>(std::size(Models::kParams)),
            Models::kReach, &Models::Project, &ModelDifference<Models>}...}};
}

constexpr std::array<CameraModel, kNumCameraModels> kModels = Describe(CameraModels());

}  // namespace

const CameraModel* AllCameraModels() { return kModels.data(); }

const CameraModel* FindCameraModel(std::string_view name) {
  for (const CameraModel& model : kModels) {
    if (name == model.name) return &model;
  }
  return nullptr;
}

}  // namespace bundle
