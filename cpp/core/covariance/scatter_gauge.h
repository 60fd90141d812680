#pragma once

/// The sandwich under inner constraints (sandwich.h, free_gauge.h).
///
/// J N = 0 in every row, so that M N = 0 and H^+ M H^+ = (P G) M (P G)^T: the gauge is taken out of
/// each solution by G. Out of G M G it cannot be taken in the end: that is as much larger than the
/// result as the square of the gauge's share in G, and nothing is left of its digits.
///
/// With the points eliminated, a gradient g of the points and b = G - sum Y_p g_p of the camera
/// parameters move these by
///
///   delta_c' = C b - N_c (K^T C b + q),        q = sum N_p^T V_p^-1 g_p.
///
/// For column j of D' = cov delta_c', n_j being row j of N_c, and
///
///   E_q = E[b q^T] = sum E_p V_p^-1 N_p,        Q = E[q q^T] = sum N_p^T V_p^-1 P_p V_p^-1 N_p,
///
///   x = C (e_j - K n_j^T),      w = C (B x - E_q n_j^T),
///   D'_j = w - N_c (K^T w + E_q^T x - Q n_j^T).
///
/// N_c^T B = 0 and N_c^T E_q = 0: both right-hand sides are within the range of S, and what
/// rounding adds beside it, which C would multiply, is taken off by z - K (N_c^T z), as N_c^T K =
/// I. B does not see what x has along N_c; there x is taken off before, since B rounds.
///
/// Points follow the camera parameters, as Y_p^T N_c = -N_p: delta_p' = V_p^-1 g_p - Y_p^T
/// delta_c',
///
///   cov delta_p' = V^-1 P V^-1 + Y^T D' Y - F - F^T,
///   F = Y^T E[delta_c' g_p^T] V^-1 = (Y^T P_c C P_c^T E_p + N_p N_p^T V^-1 P) V^-1
///
/// with P_c = I - N_c K^T, where P_c^T E_p = E_p, as N_c^T E_p = 0.
///
/// Where a point is hardly known, N^T delta is large, and with it the part of D' along N_c, of
/// which Y^T D' Y has the squares: points keep fewer digits than poses, a few 1e-6 sigmas off at
/// worst.

#include <Eigen/Core>

#include "core/covariance/free_gauge.h"
#include "core/covariance/point_blocks.h"
#include "core/covariance/reduced_system.h"

namespace bundle {

class ScatterGauge {
 public:
  /// Keeps a reference to the gauge.
  explicit ScatterGauge(const FreeGauge& gauge);

  /// Adds E_p V^-1 N_p and N_p^T V^-1 P V^-1 N_p; `e` is E_p, rows as in PointBlocks::w.
  void AddPoint(int point, const PointBlocks& blocks, const ParameterLayout& layout,
                const double* e, const double p[9]);

  /// Columns [first, first + columns) of the identity, within the range of S: unknowns x columns.
  Eigen::MatrixXd UnitColumns(int first, int columns) const;
  /// x without its part along the gauge.
  void RemoveGauge(Eigen::Ref<Eigen::MatrixXd> x) const;
  /// B x to B x - E_q n^T, of the same columns.
  void AddCrossTerms(int first, Eigen::Ref<Eigen::MatrixXd> product) const;
  /// w to D', of the same columns and their x.
  void RemoveGauge(int first, const Eigen::Ref<const Eigen::MatrixXd>& x,
                   Eigen::Ref<Eigen::MatrixXd> w) const;

 private:
  const FreeGauge& gauge_;
  Eigen::MatrixXd e_, q_;  ///< E_q, unknowns x d, and Q
};

}  // namespace bundle
