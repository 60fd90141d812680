#pragma once

/// Losses of edges: those of all factors (factors/loss.h), and two for wrong loop closures.
///
/// Both give each loop closure a switch variable s in [0, 1], which is eliminated in closed form.
/// With x = ||r||^2 and b the squared scale:
///
///   switchable constraints (Suenderhauf and Protzel, 2012) minimise s^2 x + b (1 - s)^2; the
///   minimum is at s = b / (b + x). What is left is
///
///     rho(x) = b x / (b + x),      rho' = s^2,
///
///   the loss of Geman and McClure;
///
///   dynamic covariance scaling (Agarwal, Tipaldi, Spinello, Stachniss, Burgard, 2013) takes
///   s = min(1, 2 b / (b + x)), for which rho' = s^2 integrates to
///
///     rho(x) = x up to b,    b (3 x - b) / (b + x) beyond:
///
/// inliers are not changed.
///
/// Both are bounded: a loop closure that is far off costs at most b, or 3 b.

#include "core/factors/loss.h"

namespace bundle {

struct EdgeLoss {
  enum class Kind { kOfFactors, kGemanMcClure, kDcs };

  Kind kind = Kind::kOfFactors;
  LossType type = LossType::kTrivial;  ///< loss for kOfFactors
};

/// rho, rho', rho'' at x = ||r||^2; `scale` in sigmas.
inline void ValueOfEdgeLoss(const EdgeLoss& loss, double scale, double x, double rho[3]) {
  const double b = scale * scale;
  if (loss.kind == EdgeLoss::Kind::kOfFactors) return ValueOfLoss(loss.type, scale, x, rho);
  if (loss.kind == EdgeLoss::Kind::kDcs && x <= b) {
    rho[0] = x, rho[1] = 1, rho[2] = 0;
    return;
  }
  const double s = b / (b + x);
  if (loss.kind == EdgeLoss::Kind::kGemanMcClure) {
    rho[0] = s * x, rho[1] = s * s, rho[2] = -2 * s * s / (b + x);
  } else {
    rho[0] = s * (3 * x - b), rho[1] = 4 * s * s, rho[2] = -8 * s * s / (b + x);
  }
}

}  // namespace bundle
