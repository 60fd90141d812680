#pragma once

/// The unobservable directions of a window.
///
/// Moving the world, or turning it about gravity (unit vector a), changes no residual of a camera
/// or an IMU: J N = 0, where the rows of N by the coordinates of a state (R, p, v) are
///
///   rotation (R Exp(d))   [0, R^T a]
///   position              [I, a x (p - c)]
///   velocity              [0, a x v],
///
/// all others are 0. c is the mean position, which keeps the columns independent far from the
/// origin (any point is valid). States are those at which Jacobians are taken, including first
/// estimates. Only priors remain. For H = J^T J + sum Lambda, with D^2 the damping
/// (minimize/least_squares.h),
///
///   N^T H N = sum N^T Lambda N.
///
/// Directions C with C^T (N^T H N) C = 0 have no information. These are all four columns, or the
/// columns that a prior on the first position or heading leaves free. Only the
/// translations are free if priors were linearised at other states (window.h) and therefore have
/// false information on the heading. F = N C, with F^T D^2 F = I, are the free directions.
///
/// A Newton step q has no component along F in the inner product of D^2 (schur/newton_gauge.h):
/// F^T (H + l D^2) q = l F^T D^2 q = -F^T g = 0. With rounding it has such a component, because the
/// solution divides rounding errors along F by l. The more exactly a window is solved, the farther
/// all its frames move together. The prior, which is quadratic and therefore not invariant under a
/// rotation of the world, then distorts their shape. So F F^T D^2 q is subtracted, and l stays
/// large enough to keep the other digits of q.

#include <Eigen/Core>

#include "core/window/window.h"
#include "core/window/window_prior.h"

namespace bundle {

class WindowGauge {
 public:
  static constexpr int kDegrees = 4;
  /// Minimum damping of Levenberg-Marquardt; q then keeps half of its digits along F.
  static constexpr double kLeastDamping = 1e-10;
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, kDegrees, Eigen::RowMajor>;

  WindowGauge(const WindowView& view, const WindowState& at);

  /// The rows of N w.r.t. a block's coordinates, PriorBlockSize rows.
  Rows OfBlock(int block) const;
  /// N^T Lambda N of a prior.
  Eigen::Matrix4d Information(const WindowPrior& prior, const PriorForm& form) const;

  /// C, with a column per free direction, from N^T D^2 N and N^T H N.
  static Eigen::Matrix<double, kDegrees, Eigen::Dynamic> Free(const Eigen::Matrix4d& square,
                                                              const Eigen::Matrix4d& information);

 private:
  const WindowView& view_;
  const WindowState& at_;
  Eigen::Vector3d up_, centre_;
};

}  // namespace bundle
