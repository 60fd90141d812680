#pragma once

/// A point seen in an image: r = W (pi(theta, R X + t) - m), by the residual of
/// residuals/reprojection.h.
///
/// Its variables are the pose cam_from_world (R, t) on SE(3), the parameters theta of a camera
/// model in COLMAP's order, and the point X. reprojection.h differentiates by a left perturbation
/// (u, s) of rotation and translation, P = Exp(u) R X + t + s. Moving the pose to X Exp(d), d = (w,
/// v), turns by R Exp(w) = Exp(R w) R and moves by R v to first order, so that
///
///   dr/dw = dr/du R,        dr/dv = dr/ds R.
///
/// A point behind the camera keeps the residual that the formula gives.

#include <vector>

#include "core/cameras/camera_model.h"
#include "core/factors/factor.h"
#include "core/factors/whitening.h"

namespace bundle {

class ReprojectionFactor final : public Factor {
 public:
  /// `observation` is x and y in pixels. Throws InputError if it is not finite or the information
  /// (2 x 2) is not positive definite.
  ReprojectionFactor(FactorHead head, const CameraModel& model, std::vector<double> observation,
                     std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  const CameraModel& model_;
  std::vector<double> observation_;
  Whitening whitening_;
};

}  // namespace bundle
