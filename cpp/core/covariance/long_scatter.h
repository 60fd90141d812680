#pragma once

/// The sandwich of a small system, in long doubles (sandwich.h, scatter_gauge.h).
///
/// Parameters that nearly compensate each other have sigmas far larger than their effect on points.
/// D and S^+ are large while Y^T D Y is not, and the formula of a point subtracts nearly equal
/// numbers. It is exact for any numbers Y_p, V_p^-1 and P in place of the elimination and the
/// scatter. Each number only has to be the same in all places:
///
///   cov delta_p' = V^-1 P V^-1 + Y^T D Y - r N^T - N r^T + N T N^T,    r = V^-1 P V^-1 N - Y^T R.
///
/// So Y_p, V_p^-1 and the rows of B are computed once in doubles (long_sums.h), and all further
/// numbers in long doubles.

#include <Eigen/Core>
#include <vector>

#include "core/covariance/free_gauge.h"
#include "core/covariance/long_sums.h"
#include "core/covariance/point_blocks.h"
#include "core/covariance/reduced_system.h"

namespace bundle {

class LongScatter {
 public:
  /// `lower` is L of S with the terms that fix the gauge; `meat` is B with both triangles;
  /// `variance` is s0^2. Keeps references to the system and to the gauge, which is nullptr if no
  /// similarity is free.
  LongScatter(const ReducedSystem& system, LongMatrix lower, const LongMatrix& meat,
              double variance, const FreeGauge* gauge);

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
  const double variance_;
  LongMatrix basis_;                  ///< O, unknowns x d
  LongMatrix cameras_, reduced_;      ///< N_c and K
  LongMatrix q_;                      ///< Q_q
  LongMatrix scatter_;                ///< D
  LongMatrix of_unknowns_, of_rest_;  ///< R and T
};

}  // namespace bundle
