#pragma once

#include "core/fused/minimize/dogleg_path.h"
#include "core/fused/minimize/strategy.h"

namespace bundle::fused {

/// Powell's dogleg: the Newton step as far as the radius allows, bent towards the gradient.
class Dogleg final : public Strategy {
 public:
  /// Where a combination of the two directions is best for a radius.
  using Path = Combination (*)(const DirectionProducts& products, double radius);

  explicit Dogleg(Path path) : path_(path) {}

  double Damping() const override { return damping_; }
  Step ComputeStep(LeastSquares* problem) override;
  void StepAccepted(double quality) override;
  void StepRejected() override;
  void StepIsInvalid() override;
  double Radius() const override { return radius_; }

 private:
  void FindDirections(LeastSquares* problem, Step* step);
  void IncreaseDamping();

  static constexpr double kMinDamping = 1e-8;

  const Path path_;
  double radius_ = kInitialRadius;
  double damping_ = kMinDamping;
  bool damping_has_changed_ = false;  ///< since the linearisation
  bool directions_are_known_ = false;
  DirectionProducts products_;
  double length_ = 0;  ///< ||D d|| of the last step d
};

}  // namespace bundle::fused
