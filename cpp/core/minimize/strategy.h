#pragma once

/// How a trust region finds a step for its radius, and a radius after the step.

#include <memory>
#include <string>

#include "core/interface/options.h"
#include "core/minimize/least_squares.h"

namespace bundle {

struct Step {
  LinearStatus status = LinearStatus::kSuccess;
  int num_iterations = 0;  ///< of the linear solver; 0 where it had nothing to do
  std::string message;
  Candidate candidate;  ///< where `status` is kSuccess
};

class Strategy {
 public:
  virtual ~Strategy() = default;

  /// What the problem is to be linearised with at a new x.
  virtual double Damping() const = 0;

  /// Finds a step at x, where the problem has been linearised with Damping(), and tries it. Does so
  /// again with another damping where that is needed after a step that did not succeed.
  virtual Step ComputeStep(LeastSquares* problem) = 0;

  /// One of these follows each ComputeStep. `quality`: actual decrease over predicted decrease.
  virtual void StepAccepted(double quality) = 0;
  virtual void StepRejected() = 0;
  /// There was no step, or one that promised nothing.
  virtual void StepIsInvalid() = 0;

  virtual double Radius() const = 0;

  /// Takes nearly all damping out of the steps that follow, at this x first; false where there was
  /// none to speak of.
  virtual bool Widen() { return false; }
};

std::unique_ptr<Strategy> MakeStrategy(TrustRegionStrategy type, double initial_radius);

class LevenbergMarquardt final : public Strategy {
 public:
  explicit LevenbergMarquardt(double initial_radius) : radius_(initial_radius) {}

  double Damping() const override { return 1 / radius_; }
  Step ComputeStep(LeastSquares* problem) override;
  void StepAccepted(double quality) override;
  void StepRejected() override;
  void StepIsInvalid() override { StepRejected(); }
  double Radius() const override { return radius_; }
  bool Widen() override;

 private:
  double radius_;
  double decrease_factor_ = 2;
  bool damping_has_changed_ = false;  ///< since the linearisation
};

/// The step d = p * (gradient direction) + q * (Newton direction).
struct Combination {
  double p = 0, q = 0;
  double length = 0;  ///< ||D d||
};

/// On the path from x to the minimum of the model along the gradient and on to the Newton step:
/// its end, or where it leaves the radius.
Combination TraditionalDogleg(const DoglegProducts& products, double radius);

/// The minimum of the model among all combinations within the radius.
Combination SubspaceDogleg(const DoglegProducts& products, double radius);

/// Powell's dogleg: the Newton step as far as the radius allows, bent towards the gradient.
class Dogleg final : public Strategy {
 public:
  /// Where a combination of the two directions is best for a radius.
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
  bool damping_has_changed_ = false;  ///< since the linearisation
  bool directions_are_known_ = false;
  DoglegProducts products_;
  double length_ = 0;  ///< ||D d|| of the last step d
};

}  // namespace bundle
