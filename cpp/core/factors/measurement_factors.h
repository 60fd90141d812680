#pragma once

/// Factors of a graph: priors, positions, relative motions, observed points, and the dense priors
/// from marginalisation (linear_prior.cpp).

#include <vector>

#include "core/cameras/camera_model.h"
#include "core/factors/factor.h"
#include "core/geometry/retraction.h"

namespace bundle {

/// Prior on one variable: r = W Log(Z^-1 X), X near Z with information W^T W.
///
/// The variable may be on any manifold. On a Euclidean one r = W (x - z), a prior on a point or on
/// a camera's parameters. With e = Log(Z^-1 X), Log(Z^-1 X Exp(d)) = e + J_r(e)^-1 d + O(|d|^2), so
/// that J = W J_r(e)^-1.
class PriorFactor final : public Factor {
 public:
  /// Throws InputError if the value is not on the manifold or the information is not positive
  /// definite.
  PriorFactor(FactorHead head, const Retraction& retraction, std::vector<double> value,
              std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> value_;
  Whitening whitening_;
};

/// Prior on one number x of a Euclidean variable, such as a parameter of a camera:
///
///   r = (x - z) / sigma,            dr/dx = 1 / sigma,
///
/// or, if relative, on its logarithm. Then half and twice the value have equal errors, and sigma is
/// a share (0.02: two percent):
///
///   r = (log x - log z) / sigma,    dr/dx = 1 / (sigma x).
///
/// The relative prior has a value only if x has the same sign as z.
class ScalarPriorFactor final : public Factor {
 public:
  /// Throws InputError unless `index` is one of the variable's coordinates, the variable Euclidean,
  /// value and sigma finite, sigma above 0, and, if relative, the value other than 0.
  ScalarPriorFactor(FactorHead head, const Retraction& retraction, int index, double value,
                    double sigma, bool relative);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  int index_;
  double value_;
  double sigma_;
  bool relative_;
};

/// A measured position of an antenna on a camera: r = W (R^T (a - t) - z).
///
/// (R, t) is the pose cam_from_world. The lever arm a is the antenna's position in the camera's
/// frame; for a = 0 it is the camera's centre, -R^T t. z is its measured position in the world. The
/// antenna is at y = X^-1 a. Moving X to X Exp(d), d = (w, v), moves it to
///
///   Exp(-d) y = y - w x y - v + O(|d|^2),        J = W [ [y]x  -I ].
///
/// With a second variable, a pose (R_d, t_d), the positions have an unknown offset o = A t_d,
/// A = diag(axes):
///
///   r = W (y + A t_d - z),        J_d = W [ 0  A R_d ].
///
/// Its rotation has no influence on r.
class PositionFactor final : public Factor {
 public:
  /// `lever_arm`, `position` and `axes` have three numbers; `axes`: 1 for each coordinate with an
  /// offset, else 0. Throws InputError if they are not finite or the information (3 x 3) is not
  /// positive definite.
  PositionFactor(FactorHead head, std::vector<double> position, std::vector<double> lever_arm,
                 std::vector<double> information, std::vector<double> axes = {0, 0, 0});

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> position_;
  std::vector<double> lever_arm_;
  std::vector<double> axes_;
  Whitening whitening_;
};

/// A relative measurement of two variables on one manifold: r = W Log(Z^-1 X_i^-1 X_j).
///
/// Z measures X_j in the frame of X_i. This is the error of an edge of a pose graph, with the full
/// logarithm in SE(2) and SE(3). On Euclidean variables r = W (x_j - x_i - z). Differences of
/// angles are computed by the logarithm and never exceed pi.
///
/// With e = Log(Z^-1 X_i^-1 X_j), moving X_j to X_j Exp(d) multiplies Exp(e) by Exp(d) on the
/// right. Moving X_i to X_i Exp(d) puts Exp(-d) before X_j, and with B = X_j^-1 X_i
///
///   Z^-1 Exp(-d) X_i^-1 X_j = Z^-1 X_i^-1 X_j B Exp(-d) B^-1 = Exp(e) Exp(-Ad_B d),
///
///   J_i = -W J_r(e)^-1 Ad_B,        J_j = W J_r(e)^-1.
class BetweenFactor final : public Factor {
 public:
  /// Measurement between two variables on the same manifold. Throws InputError if the measurement
  /// is not on it or the information is not positive definite.
  BetweenFactor(FactorHead head, const Retraction& retraction, std::vector<double> measurement,
                std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> measurement_;
  Whitening whitening_;
};

/// A measured relative pose of two images: r = W Log(Z^-1 X_j X_i^-1).
///
/// X_i and X_j are cam_from_world, so that X_j X_i^-1 is cam_j_from_cam_i. Z measures it, and no
/// motion of the world changes it. (A BetweenFactor would have the world's motion from one camera
/// to the other, X_i^-1 X_j.)
///
/// With e = Log(Z^-1 X_j X_i^-1), moving X_j to X_j Exp(d) changes the argument to
///
///   Z^-1 X_j Exp(d) X_i^-1 = Exp(e) X_i Exp(d) X_i^-1 = Exp(e) Exp(Ad_{X_i} d),
///
/// and moving X_i to X_i Exp(d) puts Exp(-d) there, so that
///
///   J_j = W J_r(e)^-1 Ad_{X_i},        J_i = -J_j.
class RelativePoseFactor final : public Factor {
 public:
  /// Throws InputError if the measurement is not a pose or the information (6 x 6) is not positive
  /// definite.
  RelativePoseFactor(FactorHead head, std::vector<double> measurement,
                     std::vector<double> information);

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override;

 private:
  std::vector<double> measurement_;
  Whitening whitening_;
};

/// A point seen in an image: r = W (pi(theta, R X + t) - m), by the residual of
/// factors/reprojection.h.
///
/// Its variables are the pose cam_from_world (R, t) on SE(3), the parameters theta of a camera
/// model in COLMAP's order, and the point X. reprojection.h differentiates by a left perturbation
/// (u, s) of rotation and translation, P = Exp(u) R X + t + s. Moving the pose to X Exp(d), d = (w,
/// v), turns by R Exp(w) = Exp(R w) R and moves by R v to first order, so that
///
///   dr/dw = dr/du R,        dr/dv = dr/ds R.
///
/// A point behind the camera keeps the residual of the formula.
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
