#pragma once

/// Dogleg steps (derived in dogleg.cpp).

#include "core/minimize/least_squares.h"
#include "core/minimize/strategy.h"

namespace bundle {

/// The step d = p * (gradient direction) + q * (Newton direction).
struct Combination {
  double p = 0, q = 0;
  double length = 0;  ///< ||D d||
};

/// End of the path from x to the minimum of the model along the gradient and then to the Newton
/// step, or the point where the path leaves the radius.
Combination TraditionalDogleg(const DoglegProducts& products, double radius);

/// The minimum of the model among all combinations within the radius.
Combination SubspaceDogleg(const DoglegProducts& products, double radius);

/// Powell's dogleg: the Newton step, limited by the radius and bent towards the gradient.
class Dogleg final : public Strategy {
 public:
  /// Finds the best combination of the two directions within a radius.
  using Path = Combination (*)(const DoglegProducts& products, double radius);

  Dogleg(Path path, double initial_radius) : path_(path), radius_(initial_radius) {}

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
  double radius_;
  double damping_ = kMinDamping;
  bool damping_has_changed_ = false;  ///< since the last linearisation
  bool directions_are_known_ = false;
  DoglegProducts products_;
  double length_ = 0;  ///< ||D d|| of the last step d
};

}  // namespace bundle
