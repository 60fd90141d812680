#pragma once

/// The sandwich of a small system, in long doubles (sandwich.h, scatter_gauge.h).
///
/// Parameters that nearly compensate each other have sigmas far larger than their effect on points.
/// D and S^+ are large while Y^T D Y is not, and the formulas of a point subtract nearly equal
/// numbers. The formulas are exact for any numbers t_i, g_i, Y_p and V_p^-1 in place of an
/// observation's reduced contribution, its contribution to the point, and the elimination. Each
/// number only has to be the same in all places. For a point, with E = sum t_i^T g_i and P = sum
/// g_i^T g_i over its observations,
///
///   cov delta_p' = V^-1 P V^-1 + Y^T D Y - F - F^T - r N^T - N r^T + N T N^T,
///   F = Y^T S^+ E V^-1,      r = V^-1 (P V^-1 N + E^T X) - Y^T R.
///
/// So t_i, g_i, Y_p and V_p^-1 are computed once in doubles (long_sums.h), and all further numbers
/// in long doubles.

#include <Eigen/Core>
#include <vector>

#include "core/covariance/free_gauge.h"
#include "core/covariance/long_sums.h"
#include "core/covariance/point_blocks.h"
#include "core/covariance/reduced_system.h"

namespace bundle {

class LongScatter {
 public:
  /// `lower` is L of S with the terms that fix the gauge; `meat` is B with both triangles. Keeps
  /// references to the system and to the gauge, which is nullptr if no similarity is free.
  LongScatter(const ReducedSystem& system, LongMatrix lower, const LongMatrix& meat,
              const FreeGauge* gauge);

  /// cov delta_c', n x n.
  BlockValues OfUnknowns() const;
  /// cov delta_p' of the point assembled last, 3 x 3.
  void OfPoint(int point, const PointBlocks& blocks, const PointAssembler& rows,
               double covariance[9]) const;

 private:
  struct Shares;
  Shares FindShares(int point, const PointBlocks& blocks, const PointAssembler& rows) const;
  void SumPoints();
  LongMatrix Solve(LongMatrix b) const;
  void RemoveGauge(LongMatrix* x) const;

  const ReducedSystem& system_;
  const FreeGauge* const gauge_;
  const LongMatrix lower_;
  LongMatrix basis_;                      ///< O, unknowns x d
  LongMatrix cameras_, reduced_;          ///< N_c and K
  LongMatrix e_, q_;                      ///< E_q, unknowns x d, and Q_q
  LongMatrix inverse_, scatter_;          ///< S^+ and D
  LongMatrix x_, of_unknowns_, of_rest_;  ///< X, R and T
};

}  // namespace bundle
