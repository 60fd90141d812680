#include "core/covariance/covariance.h"

#include <Eigen/Core>
#include <limits>
#include <vector>

#include "core/covariance/covariance_computation.h"
#include "core/covariance/point_pairs.h"
#include "core/geometry/rotation.h"

namespace bundle {

void CovarianceComputation::FindPoints() {
  constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  output_.points.assign(9 * size_t(view().num_points), 0.0);
  const std::vector<int64_t>& begin = system_.tracks().begin;
  for (int p = 0; p < view().num_points; ++p) {
    if (begin[p] == begin[p + 1]) std::fill_n(&output_.points[9 * size_t(p)], 9, kUnknown);
  }
  const std::vector<double>& c = system_.values();
  const std::vector<double>& prior = system_.tracks().prior;
  std::vector<PaddedRows> padded(system_.num_threads());
  system_.ForPoints([&](int p, const PointBlocks& blocks, const PointAssembler& rows, int thread) {
    Eigen::Map<Matrix3> out(&output_.points[9 * size_t(p)]);
    if (blocks.num_null > 0) {
      out.fill(kUnknown);
      return;
    }
    const Eigen::Map<const Matrix3> inverse(blocks.inverse);
    PaddedRows& y = padded[thread];
    y.Set(blocks.y);
    if (!wanted_.sandwich) {
      out = inverse;
      AddPairs(system_, c, blocks, y, y, /*is_same=*/true, out.data());
    } else {
      PointScores scores;
      SumScores(blocks, rows, prior.empty() ? nullptr : &prior[9 * size_t(p)], &scores);
      Matrix3 cross = Matrix3::Zero(), sum = Matrix3::Zero();
      PaddedRows padded_e;
      padded_e.Set(ScoresBesidePoint(blocks, scores));
      AddPairs(system_, c, blocks, y, padded_e, /*is_same=*/false, cross.data());  // V^-1 W^T C E
      AddPairs(system_, scatter_, blocks, y, y, /*is_same=*/true, sum.data());
      const Eigen::Map<const Matrix3> of_point(scores.p);
      if (constraints_ != nullptr) {
        const FreeGauge::PointRows n = gauge_->OfPoint(p);
        cross += n.lazyProduct(n.transpose()).eval() * inverse * of_point;
      }
      const Matrix3 back = cross * inverse;
      out = inverse * of_point * inverse + sum - back - back.transpose();
    }
    if (constraints_ != nullptr && !wanted_.sandwich) {
      double np[3 * kSimilarities], yp[3 * kSimilarities];
      constraints_->RowsOfPoint(p, blocks, layout(), np, yp);
      constraints_->Transform(3, np, yp, 3, np, yp, out.data());
    }
    out = (0.5 * (out + out.transpose())).eval();
  });
}

CovarianceOutput ComputeCovariance(const ProblemView& problem, const SolveOptions& options,
                                   const CovarianceOptions& wanted) {
  SolveOptions all = options;
  if (wanted.inner) all.gauge = Gauge::kNone;
  return CovarianceComputation(problem, all, wanted).Run();
}

}  // namespace bundle
