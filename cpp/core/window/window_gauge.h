#pragma once

/// The directions of a window along which nothing says where it is.
///
/// Moving the world, or turning it about gravity (unit vector a), changes no residual of a camera
/// or an IMU: J N = 0, where the rows of N by the coordinates of a state (R, p, v) are
///
///   rotation (R Exp(d))   [0, R^T a]
///   position              [I, a x (p - c)]
///   velocity              [0, a x v],
///
/// all others 0, and c is any point: the mean position, so that the columns stay apart far from the
/// origin. States are those at which Jacobians are taken, first estimates among them. What remains
/// are the priors. Of H = J^T J + sum Lambda, with D^2 the damping (minimize/least_squares.h),
///
///   N^T H N = sum N^T Lambda N.
///
/// Along C with C^T (N^T H N) C = 0 nothing is known: all four columns, those that a prior on the
/// first position or heading leaves, or the translations where priors were linearised elsewhere
/// (window.h) and seem to see the heading. F = N C, with F^T D^2 F = I, are the free directions.
///
/// A Newton step q has no part along them by the products of D^2 (schur/newton_gauge.h): F^T (H + l
/// D^2) q = l F^T D^2 q = -F^T g = 0. With rounding it has such a part, because solving divides
/// rounding errors along F by l. The more exactly a window is solved, the farther all its frames
/// move together. The prior, which is quadratic and therefore not invariant under a turn of the
/// world, then distorts their shape. So F F^T D^2 q is removed, and l stays large enough to keep
/// the other digits of q.

#include <Eigen/Core>

#include "core/window/window.h"
#include "core/window/window_prior.h"

namespace bundle {

class WindowGauge {
 public:
  static constexpr int kDegrees = 4;
  /// Levenberg-Marquardt's damping, at least: q has half of its digits along F then.
  static constexpr double kLeastDamping = 1e-10;
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, kDegrees, Eigen::RowMajor>;

  WindowGauge(const WindowView& view, const WindowState& at);

  /// The rows of N by a block's coordinates, PriorBlockSize of them.
  Rows OfBlock(int block) const;
  /// N^T Lambda N of a prior.
  Eigen::Matrix4d Information(const WindowPrior& prior, const PriorForm& form) const;

  /// C, a column per free direction, by N^T D^2 N and N^T H N.
  static Eigen::Matrix<double, kDegrees, Eigen::Dynamic> Free(const Eigen::Matrix4d& square,
                                                              const Eigen::Matrix4d& information);

 private:
  const WindowView& view_;
  const WindowState& at_;
  Eigen::Vector3d up_, centre_;
};

}  // namespace bundle
