#include "core/minimize/levenberg_marquardt.h"

#include "core/minimize/strategy.h"

/// Levenberg-Marquardt: the step is q with damping 1 / R. R is called the radius, although D q may
/// be longer. An accepted step of quality t (actual decrease over predicted decrease) sets
///
///   R = R / max(1/3, 1 - (2 t - 1)^3),
///
/// three times R if the model was right, R if it predicted twice the actual decrease, and about
/// half of R if there was hardly any decrease. Rejected and invalid steps divide R by 2, 4, 8, ...
/// until a step is accepted. (K. Madsen, H. B. Nielsen, O. Tingleff: Methods for Non-Linear Least
/// Squares Problems, 2004, with Ceres' inverted damping.)

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/interface/settling.h"

namespace bundle {

namespace {

constexpr double kForcingTerm = 0.1;  // Ceres' eta

}  // namespace

Step LevenbergMarquardt::ComputeStep(LeastSquares* problem) {
  if (damping_has_changed_) problem->Linearize(Damping());
  damping_has_changed_ = false;
  NewtonResult newton = problem->SolveNewton(kForcingTerm);
  Step step{newton.status, newton.num_iterations, std::move(newton.message), {}};
  if (step.status == LinearStatus::kSuccess) step.candidate = problem->EvaluateNewtonStep();
  return step;
}

void LevenbergMarquardt::StepAccepted(double quality) {
  radius_ = std::min(max_radius_, radius_ / std::max(1.0 / 3, 1 - std::pow(2 * quality - 1, 3)));
  decrease_factor_ = 2;
}

void LevenbergMarquardt::StepRejected() {
  radius_ /= decrease_factor_;
  decrease_factor_ *= 2;
  damping_has_changed_ = true;
}

bool LevenbergMarquardt::Widen() {
  const double wide = std::min(kWideRadius, max_radius_);
  if (radius_ >= wide) return false;
  radius_ = wide;
  damping_has_changed_ = true;
  return true;
}

}  // namespace bundle
