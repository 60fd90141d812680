#pragma once

#include "core/fused/minimize/strategy.h"

namespace bundle::fused {

class LevenbergMarquardt final : public Strategy {
 public:
  double Damping() const override { return 1 / radius_; }
  Step ComputeStep(LeastSquares* problem) override;
  void StepAccepted(double quality) override;
  void StepRejected() override;
  void StepIsInvalid() override { StepRejected(); }
  double Radius() const override { return radius_; }

 private:
  double radius_ = kInitialRadius;
  double decrease_factor_ = 2;
  bool damping_has_changed_ = false;  ///< since the linearisation
};

}  // namespace bundle::fused
