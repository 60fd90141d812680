#pragma once

/// A measured velocity of an antenna on a camera with a rolling shutter, such as GPS's by Doppler.
///
/// The row s of an image sees the world point X at Exp(s m) T X, with the twist m = (w, v) and the
/// pose T = (R, t) of the middle row (rolling_shutter.h). An antenna at l in the camera's frame,
/// the centre if l = 0, is then at X with Exp(s m) T X = l:
///
///   P(s) = R^T (Exp(-s m) l - t),        dP/ds = -R^T (w x l + v) = -R^T u    at s = 0.
///
/// One unit of s takes the time rho (the *readout*, in frame times). So the velocity in the world
/// is p = -R^T u / rho, in length units per frame, and a measured one V with information W^T W has
/// the residual
///
///   r = W (p - V).
///
/// With R moving to R Exp(d), R^T u moves by -d x R^T u, so that
///
///   dp/dd = [p]x,    dp/dt = 0,    dp/dw = R^T [l]x / rho,    dp/dv = -R^T / rho,
///   dp/drho = -p / rho.
///
/// A rotation of the world turns p, a similarity of scale c multiplies it by c, and a translation
/// has no effect: velocities hold the scale that ties of twists (twist_tie.h) would shrink.
///
/// **Readouts that are refined.** Let images measure v = z + e with the covariance S, in the
/// camera's frame. The least cost over v, (z - rho y)^2 / (S + rho^2 sigma^2) with y = -R V, has
/// its expectation's minimum at the true rho (total least squares). A residual in the unit of v, W
/// (q - rho V) for q = -R^T u, would have the denominator S + rho0^2 sigma^2, and a minimum at
/// smaller rho, as the noise of V is in the regressor. A tie of v to rho xi_v beside V leaves the
/// cost rho^2 (y - xi_v)^2 / (rho0^2 (sigma_xi^2 + sigma^2)), whatever v is, which is least at rho
/// = 0. So ties of images with a velocity then constrain w alone.

#include <vector>

#include "core/factors/factor.h"

namespace bundle {

/// Its variables are the pose of the image, its twist, and the readout of its camera. It has no
/// value at a readout that is not above 0.
class VelocityFactor final : public Factor {
 public:
  /// `velocity` in the world, per frame; `lever_arm` is l. Throws InputError unless they are finite
  /// and the information (3 x 3) is positive definite.
  VelocityFactor(FactorHead head, std::vector<double> velocity, std::vector<double> lever_arm,
                 std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> velocity_;
  std::vector<double> lever_arm_;
  Whitening whitening_;
};

}  // namespace bundle
