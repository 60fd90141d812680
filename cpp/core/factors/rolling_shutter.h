#pragma once

/// Projection by a camera that reads its image row by row while it moves.
///
/// A rolling shutter reads the pixel z = (x, y) at the *row time*
///
///   s = g . z - 1/2,      g = (0, 1/height) by rows, (1/width, 0) by columns,
///
/// in units of the readout of one frame height, zero in the middle. While it reads, the camera
/// moves with a constant *twist* m = (w, v) in its own frame. T is its pose at s = 0 and P = T X a
/// world point in that frame. At the time s the point is at
///
///   p(s) = Exp(s m) P = Exp([a]x) P + V(a) b,      a = s w,    b = s v,
///
/// with the exponential of SE(3) (geometry/rigid_motion.h; V is J_l there). Exp(s m) is a subgroup
/// of one parameter, so that another reference row has the same twist, and
///
///   dp/ds = w x p + v.
///
/// **The row.** The camera sees the point where it is when its row is read: s solves
///
///   f(s) = g . pi(p(s)) - 1/2 - s = 0,
///
/// a fixed point, by Newton's method from the measured row. With c = dpi/dp dp/ds (pixels per unit
/// of s), f' = g . c - 1. A row is read once if the image moves slower than the readout, g . c < 1.
/// Elsewhere the camera reads a point twice or never: such an observation does not count, nor one
/// whose iteration does not converge, nor one that turned by more than a radian since the middle
/// row (the series below end there). Let J be the derivative of pi(p(s)) w.r.t. any parameter at
/// constant s. By the implicit function theorem s moves by (g . J) / (1 - g . c), and the pixel by
///
///   J' = C J,      C = I + c g^T / (1 - g . c).
///
/// The residual at the *measured* row is C^-1 times that, to first order. It is smaller where rows
/// pass fast, g . c -> 1, and free twists then go there: the planar collapse (Albl et al. 2016),
/// with a lower cost than the truth. So the measured row is used only if `at_observed_row` asks for
/// it. Weighting that residual by C (Liao et al. 2023) is the fixed point to first order.
///
/// **Derivatives.** With e = a x x, f = a x e, Exp([a]x) x = x + A e + B f and V(a) x = x + B e + C
/// f, where A = sin t / t, B = (1 - cos t) / t^2, C = (t - sin t) / t^3 at t = |a|. All follow from
///
///   D = sum (-t^2)^n / (2n + 4)!,    E = sum (-t^2)^n / (2n + 5)!:
///   C = 1/6 - t^2 E,   B = 1/2 - t^2 D,   A = 1 - t^2 C,
///   A'/t = C - B,      B'/t = 2 D - C,    C'/t = 3 E - D.
///
/// A row r of a derivative w.r.t. p becomes Exp([a]x)^T r by P, s V(a)^T r by v, and s M^T r by w,
/// where M is the derivative of p w.r.t. a. With d(a x x) = -[x]x da and d(a x (a x x)) = (a x^T +
/// (a.x) I - 2 x a^T) da,
///
///   M = a z^T + (a.z) I - [u]x + (q - 2 z) a^T,    u = A P + B b,    z = B P + C b,
///   q = A'/t a x P + B'/t (a x (a x P) + a x b) + C'/t a x (a x b).
///
/// With a zero twist p(s) = P to the last bit, c = 0 and C = I: the projection of reprojection.h.
///
/// Functions are templates of the number type: the kernels process several observations at once.

#include "core/cameras/camera_model.h"

namespace bundle {

inline constexpr int kTwistSize = 6;

/// The shutter of an image at a state.
struct ImageShutter {
  double twist[kTwistSize];
  double row_scale[2];  ///< g
  bool at_observed_row = false;
};

/// Square of the largest turn since the middle row.
inline constexpr double kMaxRowTurnSquared = 1;
inline constexpr int kMaxRowSteps = 12;
/// A Newton step of s below this ends the iteration. The residual and the factor s of derivatives
/// by the twist are then corrected to first order. Other derivatives keep a relative error of this
/// size times the twist. From the measured row, two evaluations are usually enough.
inline constexpr double kLastRowStep = 1e-9;

template <typename T>
struct TurnCoefficients {
  T a, b, c, d, e;

  /// `squared`: t^2, at most 1. Eight terms of each series.
  explicit TurnCoefficients(const T& squared) {
    constexpr double kInverseFactorial[] = {1.0 / 24,
                                            1.0 / 120,
                                            1.0 / 720,
                                            1.0 / 5040,
                                            1.0 / 40320,
                                            1.0 / 362880,
                                            1.0 / 3628800,
                                            1.0 / 39916800,
                                            1.0 / 479001600,
                                            1.0 / 6227020800,
                                            1.0 / 87178291200,
                                            1.0 / 1307674368000,
                                            1.0 / 20922789888e3,
                                            1.0 / 355687428096e3,
                                            1.0 / 6402373705728e3,
                                            1.0 / 121645100408832e3};
    d = T(kInverseFactorial[14]);
    e = T(kInverseFactorial[15]);
    for (int n = 12; n >= 0; n -= 2) {
      d = T(kInverseFactorial[n]) - squared * d;
      e = T(kInverseFactorial[n + 1]) - squared * e;
    }
    c = T(1.0 / 6) - squared * e;
    b = T(0.5) - squared * d;
    a = T(1.0) - squared * c;
  }
};

template <typename T>
inline void CrossOf(const T* x, const T* y, T* out) {
  out[0] = x[1] * y[2] - x[2] * y[1];
  out[1] = x[2] * y[0] - x[0] * y[2];
  out[2] = x[0] * y[1] - x[1] * y[0];
}

template <typename T>
inline T DotOf(const T* x, const T* y) {
  return x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
}

/// A point in a camera that moves, at the time s.
template <typename T>
struct MovedPoint {
  T turn[3], shift[3];  ///< a, b
  T turn_squared;
  TurnCoefficients<T> k;
  T start[3];                       ///< P
  T once[3], twice[3];              ///< a x P, a x (a x P)
  T once_shift[3], twice_shift[3];  ///< a x b, a x (a x b)
  T point[3];                       ///< p
  T velocity[3];                    ///< dp/ds

  MovedPoint(const T* twist, const T& s, const T* camera_point)
      : turn{s * twist[0], s * twist[1], s * twist[2]},
        shift{s * twist[3], s * twist[4], s * twist[5]},
        turn_squared(DotOf(turn, turn)),
        k(turn_squared),
        start{camera_point[0], camera_point[1], camera_point[2]} {
    CrossOf(turn, start, once);
    CrossOf(turn, once, twice);
    CrossOf(turn, shift, once_shift);
    CrossOf(turn, once_shift, twice_shift);
    for (int i = 0; i < 3; ++i) {
      point[i] = start[i] + (k.a * once[i] + k.b * twice[i]) +
                 (shift[i] + (k.b * once_shift[i] + k.c * twice_shift[i]));
    }
    CrossOf(twist, point, velocity);
    for (int i = 0; i < 3; ++i) velocity[i] = velocity[i] + twist[3 + i];
  }

  /// The row of a derivative w.r.t. P, from a row w.r.t. p.
  void RowByStart(const T* row, T* out) const {
    T row_turn[3], row_turn_turn[3];
    CrossOf(row, turn, row_turn);  // -a x r
    CrossOf(row_turn, turn, row_turn_turn);
    for (int i = 0; i < 3; ++i) out[i] = row[i] + (k.a * row_turn[i] + k.b * row_turn_turn[i]);
  }

  /// M, row-major.
  void ByTurn(T* m) const {
    const T d_b = T(2.0) * k.d - k.c, d_a = k.c - k.b, d_c = T(3.0) * k.e - k.d;
    T u[3], z[3], rest[3];
    for (int i = 0; i < 3; ++i) {
      u[i] = k.a * start[i] + k.b * shift[i];
      z[i] = k.b * start[i] + k.c * shift[i];
      rest[i] =
          d_a * once[i] + d_b * (twice[i] + once_shift[i]) + d_c * twice_shift[i] - T(2.0) * z[i];
    }
    const T along = DotOf(turn, z);
    for (int i = 0; i < 3; ++i) {
      const int j = (i + 1) % 3, l = (i + 2) % 3;
      m[4 * i] = turn[i] * z[i] + rest[i] * turn[i] + along;
      m[3 * i + j] = turn[i] * z[j] + rest[i] * turn[j] + u[l];
      m[3 * i + l] = turn[i] * z[l] + rest[i] * turn[l] - u[j];
    }
  }

  /// The row of a derivative w.r.t. the twist, from a row w.r.t. p. `by_turn`: M.
  void RowByTwist(const T* by_turn, const T* row, const T& s, T* out) const {
    T row_turn[3], row_turn_turn[3];
    CrossOf(row, turn, row_turn);
    CrossOf(row_turn, turn, row_turn_turn);
    for (int j = 0; j < 3; ++j) {
      out[j] = s * (row[0] * by_turn[j] + row[1] * by_turn[3 + j] + row[2] * by_turn[6 + j]);
      out[3 + j] = s * (row[j] + (k.b * row_turn[j] + k.c * row_turn_turn[j]));
    }
  }
};

/// Multiplies by C the two rows (x, y) of a derivative, `size` numbers each; `carry`: c / (1 -
/// g.c).
template <typename T>
inline void CarryRows(const T* carry, const T* row_scale, int size, T* rows) {
  for (int j = 0; j < size; ++j) {
    const T along = row_scale[0] * rows[j] + row_scale[1] * rows[size + j];
    rows[j] = rows[j] + carry[0] * along;
    rows[size + j] = rows[size + j] + carry[1] * along;
  }
}

/// The residual of a point P in the camera's frame at the middle row, and unless they are nullptr
/// its derivatives w.r.t. P (2x3), the parameters (2 x num_params) and the twist (2x6). kUndefined
/// if the row has no solution. project(point, residual, d_point, d_params): a camera model at its
/// parameters, minus the measurement.
template <typename Project>
Projection ProjectByRow(const Project& project, int num_params, const ImageShutter& shutter,
                        const double* camera_point, const double* measurement, double* residual,
                        double* d_point, double* d_params, double* d_twist) {
  const double* const g = shutter.row_scale;
  const double measured = g[0] * measurement[0] + g[1] * measurement[1] - 0.5;
  double s = measured;
  for (int count = 0; count < kMaxRowSteps; ++count) {
    const MovedPoint<double> moved(shutter.twist, s, camera_point);
    if (!(moved.turn_squared <= kMaxRowTurnSquared)) return Projection::kUndefined;
    double by_point[6];
    const Projection projection = project(moved.point, residual, by_point, d_params);
    if (projection == Projection::kUndefined) return projection;
    double carry[2] = {};
    if (!shutter.at_observed_row) {
      const double speed[2] = {DotOf(by_point, moved.velocity),
                               DotOf(by_point + 3, moved.velocity)};
      const double slope = 1 - (g[0] * speed[0] + g[1] * speed[1]);
      if (!(slope > 0)) return Projection::kUndefined;
      const double step = (g[0] * residual[0] + g[1] * residual[1] + measured - s) / slope;
      if (!(step <= kLastRowStep && step >= -kLastRowStep)) {
        s += step;
        continue;
      }
      for (int i = 0; i < 2; ++i) {
        residual[i] += speed[i] * step;
        carry[i] = speed[i] / slope;
      }
      s += step;
    }
    if (d_point == nullptr) return projection;
    CarryRows(carry, g, 3, by_point);
    CarryRows(carry, g, num_params, d_params);
    double by_turn[9];
    moved.ByTurn(by_turn);
    for (int row = 0; row < 2; ++row) {
      moved.RowByStart(by_point + 3 * row, d_point + 3 * row);
      moved.RowByTwist(by_turn, by_point + 3 * row, s, d_twist + kTwistSize * row);
    }
    return projection;
  }
  return Projection::kUndefined;
}

/// The residual by a camera model, by its formula also where the camera cannot see the point.
inline Projection ResidualByRow(const CameraModel& model, const double* params,
                                const ImageShutter& shutter, const double* camera_point,
                                const double* measurement, double* residual) {
  const auto project = [&](const double* at, double* r, double* by_point, double* by_params) {
    double xy[2];
    const Projection found = model.project(params, at, xy, by_point, by_params);
    if (found != Projection::kUndefined) model.difference(params, xy, measurement, r, by_params);
    return found;
  };
  return ProjectByRow(project, 0, shutter, camera_point, measurement, residual, nullptr, nullptr,
                      nullptr);
}

}  // namespace bundle
