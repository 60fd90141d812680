#pragma once

/// End of a least-squares solve, measured in standard deviations of the solution.
///
/// Let f = 1/2 ||r||^2 be the cost, dof the degrees of freedom of the residuals, and
/// s0^2 = 2 f / dof the estimate of their variance. Near the minimum x*, with the normal equations
/// H and the covariance s0^2 H^-1, a step d lowers the cost by 1/2 d^T H d. By Cauchy and Schwarz,
/// sqrt(d^T H d) / s0 is the largest change by d of any function of the parameters, in standard
/// deviations of this function. So a step that lowers the cost by c moves the solution by
///
///   d_k = sqrt(2 c) / s0 = sqrt(c dof / f)    sigmas.
///
/// A relative function tolerance of t ends a solve at a step of sqrt(t dof) sigmas: of 1 sigma for
/// 1e-6 and a million degrees of freedom. And a short step does not mean a near minimum: with
/// linear convergence, decreases fall by q = (d_k / d_(k-1))^2 per step, and the rest of the way is
///
///   sqrt(2 c (q + q^2 + ...)) / s0 = d_k sqrt(q / (1 - q)).
///
/// Both must be below kNear at an accepted step (A). q is limited to kSlowest, which is also its
/// value at the first step.
///
/// (A) cannot detect directions in which damping shortens all steps. So the end is checked once by
/// the Newton decrement (B) of the camera parameters, with points eliminated and nearly no damping:
///
///   sqrt(g_c^T S^-1 g_c) / s0,
///
/// the distance to the minimum of any function of the camera parameters. Above kFar the solve goes
/// on with its own radius until its steps are shorter by the same factor as this distance has to
/// be. It also ends if the distance has not halved since the last check, because it then does not
/// measure the distance to a minimum.
///
/// Single points can slide for hundreds of steps along rays without parallax. Cameras do not depend
/// on them. Such a solve meets the function tolerance but not (A). It may end after kPatience such
/// steps, then after 2 kPatience, 4 kPatience and so on, if (B) is below kNear or has not halved
/// since the last check.
///
/// Thresholds are measured on 13 models: at the end, at most 0.095 sigmas are left.

#include <algorithm>
#include <cmath>
#include <limits>

namespace bundle {

/// Newton decrements: sqrt(g^T H^-1 g), and that of the camera parameters after the elimination of
/// the points, in units of the residuals. NaN: not known.
struct NewtonDecrement {
  double all = std::numeric_limits<double>::quiet_NaN();
  double cameras = std::numeric_limits<double>::quiet_NaN();
};

class SigmaRule {
 public:
  static constexpr double kNear = 0.1;
  static constexpr double kFar = 0.3;
  static constexpr double kSlowest = 0.98;
  static constexpr int kPatience = 10;
  /// Standard deviations below this are rounding errors of pixels.
  static constexpr double kLeastSigma = 1e-7;

  /// `dof`: 0 or less if the standard deviation of the residuals cannot be estimated.
  explicit SigmaRule(double dof) : dof_(dof) {}

  bool IsKnown() const { return dof_ > 0; }

  /// Estimated standard deviation of the residuals; NaN if it is not known.
  double Sigma(double cost) const {
    const double sigma = IsKnown() ? std::sqrt(2 * cost / dof_) : 0;
    return sigma > kLeastSigma ? sigma : std::numeric_limits<double>::quiet_NaN();
  }

  /// Adds an accepted step to a state of this cost. `decrease` is NaN if it is no decrease of one
  /// function. Returns true if the solve may end with this step, once Ends has been asked.
  bool MayEnd(double decrease, double cost, bool meets_function_tolerance) {
    const double last = step_;
    step_ = std::sqrt(2 * std::abs(decrease)) / Sigma(cost);
    if (!IsKnown() || std::isnan(Sigma(cost))) return meets_function_tolerance;
    if (!meets_function_tolerance) return false;
    const double ratio = step_ / last;
    const double q = std::isnan(ratio) ? kSlowest : std::min(ratio * ratio, kSlowest);
    is_near_ = step_ < near_ && step_ * std::sqrt(q / (1 - q)) < near_;
    return is_near_ || ++num_slow_ == patience_;
  }

  /// Decides if the solve ends with the last step, for the decrement after it.
  bool Ends(const NewtonDecrement& decrement, double cost) {
    const double left = decrement.cameras / Sigma(cost);
    if (std::isnan(left)) {
      patience_ *= 2;
      return is_near_ || !IsKnown() || std::isnan(Sigma(cost));
    }
    if (left < (is_near_ ? kFar : kNear) || left > last_left_ / 2) return true;
    last_left_ = left;
    if (is_near_) near_ = std::min(near_, step_) * kFar / left;
    if (!is_near_) patience_ *= 2;
    return false;
  }

 private:
  double dof_;
  double step_ = std::numeric_limits<double>::quiet_NaN();  ///< d_k of the last accepted step
  double near_ = kNear;
  double last_left_ = std::numeric_limits<double>::infinity();
  bool is_near_ = false;
  int num_slow_ = 0, patience_ = kPatience;
};

}  // namespace bundle
