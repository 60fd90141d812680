#pragma once

/// The sandwich under inner constraints (sandwich.h, free_gauge.h).
///
/// J N = 0 in every row, so that M N = 0 and H^+ M H^+ = (P G) M (P G)^T: G must be corrected in
/// each solution. Correcting G M G at the end does not work. It is larger than the result by the
/// square of the gauge's component in G, so that no digits of the result would remain.
///
/// The correction has two steps. If all points determined the gauge together, a poorly determined
/// point would move the world far. So the camera parameters determine it first. Let O be an
/// orthonormal basis of N_c and Q = I - O O^T. With the points eliminated, a gradient g of the
/// points and b = G - sum Y_p g_p of the camera parameters move these by
///
///   delta_c = S^+ b,   S^+ = Q C Q,        D = cov delta_c = S^+ B S^+,
///
/// column by column: x = Q C Q e_j, D_j = Q C Q (B x). As N_c^T B = 0, the Q before C and after B
/// only remove rounding errors outside the range of S, which C would amplify.
///
/// The remaining constraint is N^T delta = 0. As N_c^T delta_c = 0 and delta_p = V_p^-1 g_p - Y_p^T
/// delta_c, and as sum Y_p N_p = N_c - K,
///
///   s = N^T delta = q + K^T delta_c,        q = sum N_p^T V_p^-1 g_p,        delta' = delta - N s.
///
/// The points' own parts are independent of delta_c (sandwich.h). With Q_q = E[q q^T] = sum N_p^T
/// V_p^-1 P_p V_p^-1 N_p and X = S^+ K, the seven numbers s have
///
///   R = E[delta_c s^T] = S^+ B X,        T = E[s s^T] = Q_q + K^T R,
///
/// and for any part i of delta, cov delta' = cov delta - R_i N_j^T - N_i R_j^T + N_i T N_j^T. For a
/// point,
///
///   cov delta_p = V^-1 P V^-1 + Y^T D Y,        R_p = V^-1 P V^-1 N_p - Y^T R.
///
/// Small systems use long doubles: long_scatter.h.

#include <Eigen/Core>
#include <vector>

#include "core/covariance/free_gauge.h"
#include "core/covariance/point_blocks.h"
#include "core/covariance/reduced_system.h"

namespace bundle {

class ScatterGauge {
 public:
  using PointRows = FreeGauge::PointRows;

  /// Keeps a reference to the gauge.
  explicit ScatterGauge(const FreeGauge& gauge);

  /// Adds N_p^T V^-1 P V^-1 N_p.
  void AddPoint(int point, const PointBlocks& blocks, const double p[9]);

  /// Columns [first, first + columns) of Q: unknowns x columns.
  Eigen::MatrixXd UnitColumns(int first, int columns) const;
  /// Replaces x by Q x.
  void RemoveGauge(Eigen::Ref<Eigen::MatrixXd> x) const;

  /// Computes X, R and T from the factorised system and B.
  LinearSolution Finish(ReducedSystem* system, const BlockValues& meat);

  /// Transforms blocks of D to those of cov delta_c'.
  void TransformScatter(const BlockStructure& structure, BlockValues* values) const;
  /// Transforms cov delta_p (3 x 3, row-major) to cov delta_p'.
  void TransformPoint(int point, const PointBlocks& blocks, const ParameterLayout& layout,
                      const double p[9], double* covariance) const;

 private:
  const FreeGauge& gauge_;
  const Eigen::MatrixXd basis_;            ///< O, unknowns x d
  Eigen::MatrixXd q_;                      ///< Q_q
  Eigen::MatrixXd of_unknowns_, of_rest_;  ///< R and T
};

}  // namespace bundle
