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
  const auto set = [&](int p, const Matrix3& covariance) {
    Eigen::Map<Matrix3>(&output_.points[9 * size_t(p)]) =
        0.5 * (covariance + covariance.transpose());
  };
  std::vector<PaddedRows> padded(system_.num_threads());
  const auto one_by_one = [&](int p, const PointBlocks& blocks, const PointAssembler& rows,
                              int thread) {
    set(p, wanted_.sandwich ? ScatterOfPoint(p, blocks, rows, &padded[thread])
                            : OfPoint(p, blocks, &padded[thread]));
  };
  if (wanted_.sandwich) {
    system_.ForPoints(one_by_one);
  } else {
    system_.FindPointCovariances(constraints_ == nullptr ? nullptr : gauge_.get(),
                                 output_.points.data());
    system_.ForPoints(system_.num_threads(), system_.unclear_points(), one_by_one);
  }
  const std::vector<int64_t>& begin = system_.tracks().begin;
  const auto forget = [&](int p) { std::fill_n(&output_.points[9 * size_t(p)], 9, kUnknown); };
  for (int p = 0; p < view().num_points; ++p) {
    if (begin[p] == begin[p + 1]) forget(p);
  }
  for (const NullPoint& null : system_.null_points()) forget(null.point);
}

/// Three points that fix the gauge also fix the shape of their triangle (gauge.cpp).
void CovarianceComputation::WarnOfTriangle() {
  if (options_.gauge != Gauge::kThreePoints) return;
  if (SelectFreeParameters(view(), options_).point == layout().free().point) return;
  Warn(WarningKind::kGaugeNotHeld,
       "Gauge three_points fixes 2 numbers too many, the shape of a triangle: all "
       "covariances are too small. Use inner or two_cameras.",
       &output_.warnings);
}

void CovarianceComputation::RefuseKeptPoints() const {
  if (layout().kept_points().empty()) return;
  throw InputError("robust: expected weights beside a factor that joins points, found sandwich");
}

CovarianceComputation::Matrix3 CovarianceComputation::OfKeptPoint(int point) const {
  const int block = layout().kept_block(point);
  const Matrix covariance = BlockOf(block, block);
  return 0.5 * (covariance + covariance.transpose());
}

void CovarianceComputation::FindKeptPoints() {
  for (const int p : layout().kept_points()) {
    Eigen::Map<Matrix3>(&output_.points[9 * size_t(p)]) = OfKeptPoint(p);
  }
}

/// - N_p N_p^T V^-1 - V^-1 N_p N_p^T (free_gauge.h)
void CovarianceComputation::TakeGaugeOut(int point, const double* inverse,
                                         Matrix3* covariance) const {
  if (constraints_ == nullptr) return;
  const FreeGauge::PointRows n = gauge_->OfPoint(point);
  const Matrix3 squares = n.lazyProduct(n.transpose());
  const Matrix3 back = squares * Eigen::Map<const Matrix3>(inverse);
  *covariance -= back + back.transpose();
}

CovarianceComputation::Matrix3 CovarianceComputation::OfPoint(int point, const PointBlocks& blocks,
                                                              PaddedRows* y) const {
  y->Set(blocks.y);
  Matrix3 out = Eigen::Map<const Matrix3>(blocks.inverse);
  AddPairs(system_, system_.values(), blocks, *y, out.data());
  TakeGaugeOut(point, blocks.inverse, &out);
  return out;
}

/// sandwich.h, scatter_gauge.h
CovarianceComputation::Matrix3 CovarianceComputation::ScatterOfPoint(int point,
                                                                     const PointBlocks& blocks,
                                                                     const PointAssembler& rows,
                                                                     PaddedRows* y) const {
  if (long_scatter_ != nullptr) {
    Matrix3 out;
    long_scatter_->OfPoint(point, blocks, rows, out.data());
    return out;
  }
  const std::vector<double>& prior = system_.tracks().prior;
  const Eigen::Map<const Matrix3> inverse(blocks.inverse);
  y->Set(blocks.y);
  double p[9];
  ExpectScatter(rows, variance_, prior.empty() ? nullptr : &prior[9 * size_t(point)], p);
  Matrix3 out = inverse * Eigen::Map<const Matrix3>(p) * inverse;
  AddPairs(system_, scatter_, blocks, *y, out.data());
  if (scatter_gauge_ != nullptr) {
    scatter_gauge_->TransformPoint(point, blocks, layout(), p, out.data());
  }
  return out;
}

CovarianceOutput ComputeCovariance(const AdjustmentProblem& problem, const SolveOptions& options,
                                   const CovarianceOptions& wanted) {
  SolveOptions all = options;
  if (wanted.inner) all.gauge = Gauge::kNone;
  return CovarianceComputation(problem, all, wanted).Run();
}

}  // namespace bundle
