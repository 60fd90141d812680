#pragma once

/// A tie of an image's twist to the poses of its neighbours in a video.
///
/// Let T_a and T_b be the poses of two images, n frames apart, between which the camera moves with
/// a constant velocity. Its motion per frame time, in the camera's frame, is
///
///   xi = Log(T_b T_a^-1) / n,
///
/// exactly, because Exp(s xi) is a subgroup of one parameter. An image between them that is read in
/// the share rho of a frame time (the *readout*) has the twist m = rho xi (rolling_shutter.h). The
/// tie is the residual
///
///   r = W (m - rho xi),        W = diag(1 / sigma_w, 1 / sigma_v),
///
/// of the twist itself. A residual of m / rho would be the same tie with weights that depend on
/// rho, and its estimate of rho is biased upwards by the noise of xi (errors in variables).
///
/// With e = Log(T_b T_a^-1), moving T_b to T_b Exp(d) changes the argument to
///
///   T_b Exp(d) T_a^-1 = T_b T_a^-1 Exp(Ad_{T_a} d),
///
/// and moving T_a to T_a Exp(d) puts -d there, so that
///
///   dr/dT_b = -W rho / n J_r(e)^-1 Ad_{T_a} = -dr/dT_a,    dr/dm = W,    dr/drho = -W xi.
///
/// A *hard* tie is m = rho xi itself: the twist is no variable, and its derivatives w.r.t. the
/// charts of both poses (factors/reprojection.h: d is R^T J_l dw, R^T dt) and rho are a `TwistMap`.
///
/// A similarity of the world with scale c multiplies v, the translation of xi and their difference
/// by c: ties alone would shrink the scene. Something else must determine the scale.

#include "core/factors/factor.h"
#include "core/factors/reprojection.h"
#include "core/factors/rolling_shutter.h"

namespace bundle {

/// xi of two poses (qx qy qz qw tx ty tz), `num_frames` apart. Unless they are nullptr, also its
/// derivative (6 x 6) by d of T_b Exp(d); that of T_a is its negative.
void TwistBetween(const double* pose_a, const double* pose_b, double num_frames, double* xi,
                  double* by_pose_b);

/// Derivatives of a hard-tied twist w.r.t. (w, t) of the poses before and after, 6 x 6, and rho.
struct TwistMap {
  double before[36], after[36], readout[kTwistSize];
};

/// rho xi and its derivatives. `states` of the two poses have the rotations and left Jacobians.
void HardTwist(const double* pose_a, const double* pose_b, const PoseState& state_a,
               const PoseState& state_b, double num_frames, double rho, double* twist,
               TwistMap* map);

/// Its variables are the twist of the image, the readout of its camera, T_a and T_b.
class TwistTieFactor final : public Factor {
 public:
  /// Throws InputError unless num_frames is finite and above 0, and both sigmas are; sigma_v may
  /// also be infinite, for a tie of the rotation alone.
  TwistTieFactor(FactorHead head, double num_frames, double sigma_w, double sigma_v);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;
  int num_measurements() const override { return weights_[1] > 0 ? kTwistSize : 3; }

 private:
  double num_frames_;
  double weights_[2];
};

}  // namespace bundle
