#pragma once

/// A spot check of the linearisation: at a sample of observations, each column of the claimed
/// Jacobian is held against differences of the residual. The iterations of a solve do not tell a
/// column that is far too small from bad scaling (convergence_watch.h); this does.
///
/// Along the axis of one number x_j, with D(h) = (r(x + h e_j) - r(x - h e_j)) / 2h,
///
///   R = D(h/2) + (D(h/2) - D(h)) / 3 = dr/dx_j + O(h^4),     u = ||D(h/2) - D(h)||,
///
/// where u, of order h^2, is far above the error of R wherever r is smooth at the scale of h, and
/// of the size of R where it is not: across a fold, a seam or the camera's plane. Rounding adds n /
/// h to u, with n = eps (||r|| + sum_k |x_k| ||J_k||), what the last digits of x and r may change.
/// A step is *conclusive* if u is below a hundredth of ||R||. The column J_j then agrees with it if
///
///   ||J_j - R|| < 1e-3 max(||J_j||, ||R||) + 4 u.
///
/// h moves the residual by a given part of a pixel, as the largest claimed column of j's kind has
/// it (rotation, translation, point, or the one parameter): for true columns that is a scale at
/// which the residual is nearly linear, be coordinates 1e-9 or 1e9, and false ones, 1000 times too
/// large or too small, are still seen at one of four such scales. Where nothing seems to move, the
/// size of what is moved bounds h. A needle narrower than h may yet look smooth: near the pole of a
/// panorama, say, or a camera's centre. So
///
/// - any conclusive step that agrees acquits the observation's column,
/// - two conclusive steps, 100 times apart or more, that agree and are not J_j convict it,
/// - everything else leaves it undecided,
///
/// and a column is reported where it is convicted in a quarter, and four, of the decided
/// observations of a camera model, which must be a tenth of those tried: however hard a problem,
/// the residual would have to mislead at every scale in many places. What this leaves to `bundle
/// check`: columns that are wrong in a few observations or by less than one in a thousand, and
/// columns that should be zero and are not, since a residual that lost its last digit does not move
/// either.

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/cameras/camera_model.h"
#include "core/solve/parameter_layout.h"

namespace bundle {

/// An observation and the numbers that its residual depends on: x = (w, t, parameters of the
/// model, point).
struct ObservationAtPoint {
  static constexpr int kMaxSize = kPoseSize + kMaxCameraParams + 3;

  int64_t observation = 0;
  const CameraModel* model = nullptr;
  uint32_t free = 0;  ///< bit j: x_j is refined; the others are not checked
  double x[kMaxSize] = {};

  int size() const { return kPoseSize + model->num_params + 3; }
};

/// The residual (2) of an observation at x and, unless `jacobian` is nullptr, the derivatives that
/// are claimed for it: 2 x size, row-major. False where the observation does not count.
using ClaimedDerivatives =
    std::function<bool(int64_t observation, const double* x, double* residual, double* jacobian)>;

/// One sentence that says which kind of column is wrong by how much, and names `bundle check`; ""
/// if nothing is. Takes some 5 microseconds an observation.
std::string SpotCheck(const std::vector<ObservationAtPoint>& sample,
                      const ClaimedDerivatives& derivatives);

}  // namespace bundle
