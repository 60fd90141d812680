#pragma once

/// The one list of camera models. To add a model: write its header, add it to `CameraModels`.

#include <string_view>
#include <tuple>

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

/// The models in the order of `CameraModels`.
const CameraModel* AllCameraModels();

/// nullptr if there is no such model.
const CameraModel* FindCameraModel(std::string_view name);

}  // namespace bundle
