#pragma once

/// The tangential part of Brown's distortion (1966), of coefficients p1 and p2.
///
/// With s = u^2 + v^2
///
///   t_u = 2 p1 u v + p2 (s + 2 u^2),   t_v = 2 p2 u v + p1 (s + 2 v^2),
///   dt_u/du = 2 p1 v + 6 p2 u,   dt_u/dv = dt_v/du = 2 p1 u + 2 p2 v,   dt_v/dv = 2 p2 u + 6 p1 v,
///   dt_u/d(p1, p2) = (2 u v, s + 2 u^2),   dt_v/d(p1, p2) = (s + 2 v^2, 2 u v).

namespace bundle {

template <typename T>
struct Decentering {
  T u, v;                 ///< t_u, t_v
  T du_du, cross, dv_dv;  ///< dt_u/du; dt_u/dv = dt_v/du; dt_v/dv
  T du_dp1, du_dp2, dv_dp1, dv_dp2;

  Decentering(T p1, T p2, T x, T y)
      : du_du(2 * p1 * y + 6 * p2 * x),
        cross(2 * (p1 * x + p2 * y)),
        dv_dv(2 * p2 * x + 6 * p1 * y),
        du_dp1(2 * x * y),
        du_dp2(3 * x * x + y * y),
        dv_dp1(x * x + 3 * y * y),
        dv_dp2(du_dp1) {
    u = p1 * du_dp1 + p2 * du_dp2;
    v = p2 * dv_dp2 + p1 * dv_dp1;
  }
};

}  // namespace bundle
