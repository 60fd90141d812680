#pragma once

/// The one list of camera models. To add a model: write its header, add it to `CameraModels`.

#include <array>
#include <cstddef>
#include <iterator>
#include <string_view>
#include <tuple>
#include <utility>

#include "core/cameras/camera_model.h"
#include "core/cameras/division.h"
#include "core/cameras/equirectangular.h"
#include "core/cameras/eucm.h"
#include "core/cameras/fisheye.h"
#include "core/cameras/fov.h"
#include "core/cameras/opencv.h"
#include "core/cameras/perspective.h"
#include "core/cameras/thin_prism_fisheye.h"

namespace bundle {

/// All camera models, in the order of COLMAP's ids.
using CameraModels =
    std::tuple<SimplePinhole, Pinhole, SimpleRadial, Radial, OpenCv, OpenCvFisheye, FullOpenCv, Fov,
               SimpleRadialFisheye, RadialFisheye, ThinPrismFisheye, RadTanThinPrismFisheye,
               SimpleDivision, Division, SimpleFisheye, Fisheye, Eucm, Equirectangular>;

inline constexpr int kNumCameraModels = static_cast<int>(std::tuple_size_v<CameraModels>);

template <typename Model>
inline constexpr int kNumParams = static_cast<int>(std::size(Model::kParams));

namespace internal {

template <typename... Models>
constexpr std::array<CameraModel, sizeof...(Models)> Describe(std::tuple<Models...>) {
  static_assert(((kNumParams<Models> <= kMaxCameraParams) && ...));
  return {{{Models::kName, Models::kParams, kNumParams<Models>, Models::kReach, &Models::Project,
            &ModelDifference<Models>}...}};
}

inline constexpr std::array<CameraModel, kNumCameraModels> kModels = Describe(CameraModels());

template <typename Visitor, std::size_t... kIndices>
void VisitCameraModelImpl(std::ptrdiff_t index, Visitor&& visitor,
                          std::index_sequence<kIndices...>) {
  ((index == static_cast<std::ptrdiff_t>(kIndices)
        ? visitor(std::tuple_element_t<kIndices, CameraModels>())
        : void()),
   ...);
}

}  // namespace internal

/// The models in the order of `CameraModels`.
inline const CameraModel* AllCameraModels() { return internal::kModels.data(); }

/// nullptr if there is no such model.
inline const CameraModel* FindCameraModel(std::string_view name) {
  for (const CameraModel& model : internal::kModels) {
    if (name == model.name) return &model;
  }
  return nullptr;
}

/// Calls visitor(Model()) with the struct of a model, so that its code is inlined.
template <typename Visitor>
void VisitCameraModel(const CameraModel& model, Visitor&& visitor) {
  internal::VisitCameraModelImpl(&model - AllCameraModels(), std::forward<Visitor>(visitor),
                                 std::make_index_sequence<kNumCameraModels>());
}

}  // namespace bundle
