#pragma once

/// A measured position of an antenna on a camera: r = W (R^T (a - t) - z).
///
/// (R, t) is the pose cam_from_world, a the lever arm, which is the antenna's place in the frame of
/// the camera, and z its measured place in the world; for a = 0 it is the camera's centre, -R^T t.
/// The antenna is at y = X^-1 a. Moving X to X Exp(d), d = (w, v), makes it
///
///   Exp(-d) y = y - w x y - v + O(|d|^2),        J = W [ [y]x  -I ].

#include <vector>

#include "core/factors/factor.h"
#include "core/factors/whitening.h"

namespace bundle {

class PositionFactor final : public Factor {
 public:
  /// `lever_arm` and `position` have three numbers. Throws InputError if they are not finite or the
  /// information (3 x 3) is not positive definite.
  PositionFactor(FactorHead head, std::vector<double> position, std::vector<double> lever_arm,
                 std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> position_;
  std::vector<double> lever_arm_;
  Whitening whitening_;
};

}  // namespace bundle
