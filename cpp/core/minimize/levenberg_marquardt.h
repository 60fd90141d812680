#pragma once

/// Levenberg-Marquardt steps (derived in levenberg_marquardt.cpp).

#include "core/minimize/least_squares.h"
#include "core/minimize/strategy.h"

namespace bundle {

class LevenbergMarquardt final : public Strategy {
 public:
  LevenbergMarquardt(double initial_radius, double max_radius)
      : max_radius_(max_radius), radius_(initial_radius) {}

  double Damping() const override { return 1 / radius_; }
  Step ComputeStep(LeastSquares* problem) override;
  void StepAccepted(double quality) override;
  void StepRejected() override;
  void StepIsInvalid() override { StepRejected(); }
  double Radius() const override { return radius_; }
  bool Widen() override;

 private:
  const double max_radius_;
  double radius_;
  double decrease_factor_ = 2;
  bool damping_has_changed_ = false;  ///< since the last linearisation
};

}  // namespace bundle
