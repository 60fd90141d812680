#include "core/fused/minimize/dogleg.h"

/// The radius R bounds ||D d||. It is halved by a rejected step and by one of a quality below 1/4,
/// and becomes at least three times the length of a step of a quality above 3/4. The directions
/// depend on x alone: a rejected step costs one more candidate and no solution of the normal
/// equations.
///
/// Damping is there for normal equations that are nearly singular, and independent of R: 1e-8, ten
/// times more after a failure or an invalid step, up to 1; a fifth after each accepted step.

#include <algorithm>
#include <utility>

namespace bundle::fused {
namespace {

constexpr double kMaxDamping = 1;
constexpr double kDampingFactor = 10;
constexpr double kPoorQuality = 0.25;
constexpr double kGoodQuality = 0.75;
constexpr double kExactly = 0;  // the forcing term: a path needs the whole Newton direction

}  // namespace

Step Dogleg::ComputeStep(LeastSquares* problem) {
  Step step;
  if (!directions_are_known_) FindDirections(problem, &step);
  if (step.status != NewtonResult::Status::kSuccess) return step;
  const Combination best = path_(products_, radius_);
  length_ = best.length;
  step.candidate = problem->TryCombination(best.p, best.q);
  return step;
}

void Dogleg::FindDirections(LeastSquares* problem, Step* step) {
  step->status = NewtonResult::Status::kFailure;
  step->num_iterations = -1;  // as Ceres has it where even the largest damping has failed before
  while (damping_ < kMaxDamping && step->status == NewtonResult::Status::kFailure) {
    if (damping_has_changed_) problem->Linearize(damping_);
    damping_has_changed_ = false;
    NewtonResult newton = problem->SolveNewton(kExactly);
    step->status = newton.status;
    step->num_iterations = newton.num_iterations;
    step->message = std::move(newton.message);
    if (step->status == NewtonResult::Status::kFailure) IncreaseDamping();
  }
  if (step->status != NewtonResult::Status::kSuccess) return;
  products_ = problem->Products();
  directions_are_known_ = true;
}

void Dogleg::IncreaseDamping() {
  damping_ *= kDampingFactor;
  damping_has_changed_ = true;
}

void Dogleg::StepAccepted(double quality) {
  if (quality < kPoorQuality) radius_ *= 0.5;
  if (quality > kGoodQuality) radius_ = std::max(radius_, 3 * length_);
  damping_ = std::max(kMinDamping, 2 * damping_ / kDampingFactor);
  damping_has_changed_ = false;
  directions_are_known_ = false;
}

void Dogleg::StepRejected() { radius_ *= 0.5; }

void Dogleg::StepIsInvalid() {
  IncreaseDamping();
  directions_are_known_ = false;
}

}  // namespace bundle::fused
