#pragma once

#include <memory>

#include "core/ceres/ceres_version.h"
#include "core/solve/options.h"

namespace bundle {

/// rho(s), s = ||r||^2, bending where ||r|| reaches `scale` pixels; nullptr for the trivial loss,
/// which Ceres then skips.
std::unique_ptr<ceres::LossFunction> MakeLoss(LossType type, double scale);

}  // namespace bundle
