#include "core/ceres/losses.h"

namespace bundle {

std::unique_ptr<ceres::LossFunction> MakeLoss(LossType type, double scale) {
  switch (type) {
    case LossType::kTrivial:
      return nullptr;
    case LossType::kHuber:
      return std::make_unique<ceres::HuberLoss>(scale);
    case LossType::kSoftL1:
      return std::make_unique<ceres::SoftLOneLoss>(scale);
    case LossType::kCauchy:
      return std::make_unique<ceres::CauchyLoss>(scale);
    case LossType::kArctan:
      // Ceres compares s itself, not its root, with the scale of this one.
      return std::make_unique<ceres::ArctanLoss>(scale * scale);
    case LossType::kTukey:
      return std::make_unique<ceres::TukeyLoss>(scale);
  }
  return nullptr;
}

}  // namespace bundle
