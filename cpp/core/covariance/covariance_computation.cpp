#include "core/covariance/covariance_computation.h"

/// The factor of a covariance's S, the sandwich, and covariances of relative poses.
///
/// Small systems are factorised in long doubles. The joint covariance of two images is in general
/// not a block of the selected inverse, so that columns of S^-1 are solved for.

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <map>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "core/covariance/leverages.h"
#include "core/covariance/long_scatter.h"
#include "core/covariance/long_sums.h"
#include "core/covariance/sandwich.h"
#include "core/dense/decompositions.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

void CovarianceComputation::CountResiduals() {
  output_.weighted_squares = system_.point_sums().squares;
  output_.num_residuals = system_.point_sums().num_residuals;
  output_.predicted_decrease = system_.point_sums().decrease;
  system_.ForObservationsOfFixedPoints([&](const ObservationRows& rows) {
    output_.weighted_squares +=
        rows.residual[0] * rows.residual[0] + rows.residual[1] * rows.residual[1];
    output_.num_residuals += 2;
  });
  system_.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    for (const double r : rows.residual) output_.weighted_squares += r * r;
    output_.num_residuals += rows.num_measurements;
  });
  output_.num_parameters = system_.num_unknowns() + 3 * int64_t{layout().num_free_points()};
  for (const uint8_t bit : system_.held()) output_.num_parameters -= bit;
  for (const NullPoint& null : system_.null_points()) output_.num_parameters -= null.num_null;
}

/// S with the terms that fix its gauge, in long doubles, from rows; empty for a large system.
LongMatrix CovarianceComputation::SumHeld() const {
  if (!is_small_) return {};
  LongMatrix held = SumSystemOfRows(system_);
  if (output_.gauge_degrees == 0) return held;
  const LongMatrix b = gauge_->HeldDirections().cast<long double>();
  return held + b.lazyProduct(b.transpose());
}

/// S^-1 of a small system; empty for a large one.
LongMatrix CovarianceComputation::LongInverse() const {
  LongMatrix inverse;
  if (!is_small_) return inverse;
  inverse.setIdentity(lower_.rows(), lower_.cols());
  SolveLong(lower_, &inverse);
  return inverse;
}

/// Leverages need the blocks of S^-1, so that S is factorised twice.
void CovarianceComputation::CorrectScores() {
  Factorize();
  const LongMatrix inverse = LongInverse();
  if (!is_small_) Check(system_.Invert());
  CorrectedResiduals corrected = CorrectForLeverage(system_, inverse);
  variance_ = corrected.variance;
  output_.predicted_decrease = system_.point_sums().decrease / corrected.kappa;
  system_.SetScores(std::move(corrected.scores), corrected.kappa);
  system_.SetSystem(SumBread(system_));
  HoldGauge();
}

void CovarianceComputation::FindScatter() {
  if (is_small_) {
    long_scatter_ =
        std::make_unique<LongScatter>(system_, std::move(lower_), SumMeatOfRows(system_), variance_,
                                      constraints_ == nullptr ? nullptr : gauge_.get());
    scatter_ = long_scatter_->OfUnknowns();
    return;
  }
  if (constraints_ != nullptr) scatter_gauge_ = std::make_unique<ScatterGauge>(*gauge_);
  const BlockValues meat = SumMeat(system_, variance_, scatter_gauge_.get());
  Check(SolveForScatter(&system_, meat, scatter_gauge_.get(), &scatter_));
  if (scatter_gauge_ != nullptr) Check(scatter_gauge_->Finish(&system_, meat));
}

void CovarianceComputation::Factorize() {
  const LongMatrix held = SumHeld();
  Check(system_.Factorize());
  if (held.size() > 0) {
    const Eigen::Index n = held.rows();
    if (std::optional<LongMatrix> lower = LongCholesky(held)) {
      lower_ = std::move(*lower);
      const Eigen::MatrixXd rounded = lower_.cast<double>();
      system_.TakeFactor(rounded.data());
    } else {  // a pivot at rounding level, which is judged below
      lower_ = Eigen::Map<const Eigen::MatrixXd>(system_.values().data(), n, n)
                   .triangularView<Eigen::Lower>()
                   .toDenseMatrix()
                   .cast<long double>();
    }
  }
  int unknown = 0;
  const double pivot = system_.SmallestPivot(&unknown);
  if (pivot > kSingular) {
    const std::vector<double>& rhs = system_.rhs();
    step_.setZero(static_cast<Eigen::Index>(rhs.size()), 1);
    Check(system_.Solve(rhs.data(), 1, step_.data()));
    for (size_t j = 0; j < rhs.size(); ++j) {
      output_.predicted_decrease += 0.5 * step_.data()[j] * rhs[j];
    }
    return;
  }
  NotDetermined(unknown, "a pivot of " + ShortNumber(pivot) + " of its diagonal entry");
}

/// The derivatives of the pose of an image with respect to the unknowns: unknowns x 6.
Eigen::MatrixXd CovarianceComputation::UnknownsOfImage(int image) const {
  Eigen::MatrixXd unknowns = Eigen::MatrixXd::Zero(system_.num_unknowns(), 6);
  for (const LocalMap& map : system_.evaluator().maps(image)) {
    unknowns.middleRows(layout().blocks()[map.block].offset, map.size) +=
        WholeMap(map).topRows<6>().transpose();
  }
  return unknowns;
}

/// The covariance of all unknowns with linear functions of them, whose coefficients are columns.
CovarianceComputation::Matrix CovarianceComputation::CovarianceTimes(const Eigen::MatrixXd& rhs) {
  const int n = system_.num_unknowns(), count = static_cast<int>(rhs.cols());
  Eigen::MatrixXd x = Eigen::MatrixXd::Zero(n, count);
  Check(system_.Solve(rhs.data(), count, x.data()));
  if (wanted_.sandwich) {
    FullVectors with_points;  // M H^-1, whose rows for points follow from the cameras
    with_points.num_columns = count;
    with_points.cameras.assign(rhs.data(), rhs.data() + rhs.size());
    with_points.points.assign(3 * size_t(count) * size_t(view().num_points), 0.0);
    FullVectors once, twice;
    const auto solve = [&](FullVectors* to) {  // P G P^T
      if (constraints_ != nullptr) gauge_->ProjectTransposed(&with_points);
      Check(system_.Solve(with_points, to));
      if (constraints_ != nullptr) gauge_->Project(to);
    };
    FullVectors own;
    if (constraints_ != nullptr) {  // also move the points, which have their own scatter
      gauge_->ProjectTransposed(&with_points);
      own = with_points;
      with_points = ReduceByPoints(system_, own);
    }
    solve(&once);
    with_points = MeatTimes(system_, once);
    solve(&twice);
    if (constraints_ != nullptr) {
      AddOwnScatter(system_, variance_, own, &twice);
      gauge_->Project(&twice);
    }
    x = Eigen::Map<const Eigen::MatrixXd>(twice.cameras.data(), n, count);
  }
  Matrix columns = x;
  const InnerConstraints* const inner = wanted_.sandwich ? nullptr : constraints_.get();
  if (inner != nullptr && n > 0) {
    const int d = inner->degrees();
    std::vector<double> na(size_t(n) * d), ya(na);
    inner->RowsOfUnknowns(0, n, na.data(), ya.data());
    const Eigen::Map<const Matrix> all_n(na.data(), n, d), all_y(ya.data(), n, d);
    const Matrix own_n = MultiplyTransposed(rhs, all_n), own_y = MultiplyTransposed(rhs, all_y);
    inner->Transform(n, na.data(), ya.data(), count, own_n.data(), own_y.data(), columns.data());
  }
  return columns;
}

/// The rows of an image's pose, for each column of unknowns.
CovarianceComputation::Matrix CovarianceComputation::LocalRows(int image,
                                                               const Matrix& columns) const {
  Matrix rows = Matrix::Zero(6, columns.cols());
  for (const LocalMap& map : system_.evaluator().maps(image)) {
    rows += WholeMap(map).topRows<6>().lazyProduct(
        columns.middleRows(layout().blocks()[map.block].offset, map.size));
  }
  return rows;
}

CovarianceComputation::Matrix6 CovarianceComputation::OfRelativePose(int a, int b,
                                                                     const Matrix& from_a,
                                                                     const Matrix& from_b) const {
  const PoseState &pose_a = system_.states().pose(a), &pose_b = system_.states().pose(b);
  const Matrix3 relative = Eigen::Map<const Matrix3>(pose_b.rotation) *
                           Eigen::Map<const Matrix3>(pose_a.rotation).transpose();
  const Matrix3 arm = Skew(relative * Eigen::Map<const Vector3>(pose_a.translation));
  Matrix6 by_a = Matrix6::Zero(), by_b = Matrix6::Identity();
  by_a.block<3, 3>(0, 0) = -relative;
  by_a.block<3, 3>(3, 0) = -arm * relative;
  by_a.block<3, 3>(3, 3) = -relative;
  by_b.block<3, 3>(3, 0) = arm;
  const Matrix6 aa = LocalRows(a, from_a), ba = LocalRows(b, from_a), bb = LocalRows(b, from_b);
  const Matrix6 mixed = by_b * ba * by_a.transpose();
  return by_a * aa * by_a.transpose() + by_b * bb * by_b.transpose() + mixed + mixed.transpose();
}

void CovarianceComputation::FindSteps() {
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  output_.steps.resize(6 * size_t(view().num_images));
  for (int i = 0; i < view().num_images; ++i) {
    Vector6 step = LocalRows(i, step_);
    if (centered_.is_moved()) step = MapBack(i) * step;
    Eigen::Map<Vector6>(&output_.steps[6 * size_t(i)]) = step;
  }
}

void CovarianceComputation::FindFunctions() {
  const int width = kPoseSize + view().camera_params_stride;
  const size_t size = size_t(view().num_images) * width;
  if (wanted_.functions.empty()) return;
  const auto count = static_cast<Eigen::Index>(wanted_.functions.size() / size);
  Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(system_.num_unknowns(), count);
  for (int i = 0; i < view().num_images; ++i) {
    Eigen::MatrixXd local = Eigen::MatrixXd::Zero(kLocal, count);
    for (Eigen::Index k = 0; k < count; ++k) {
      const double* const from = &wanted_.functions[size_t(k) * size + size_t(i) * width];
      std::copy_n(from, std::min(width, kPoseSize + kMaxCameraParams), local.col(k).data());
    }
    if (centered_.is_moved())
      local.topRows<6>() = MapBack(i).transpose().lazyProduct(local.topRows<6>()).eval();
    for (const LocalMap& map : system_.evaluator().maps(i)) {
      rhs.middleRows(layout().blocks()[map.block].offset, map.size) +=
          WholeMap(map).transpose().lazyProduct(local);
    }
  }
  const Eigen::MatrixXd own = AddFunctionsOfPoints(&rhs);
  const Matrix found = MultiplyTransposed(rhs, CovarianceTimes(rhs)) + own;
  output_.functions.assign(found.data(), found.data() + found.size());
}

/// Adds the coefficients by points; returns f_p^T V_p^-1 f_p', functions x functions.
Eigen::MatrixXd CovarianceComputation::AddFunctionsOfPoints(Eigen::MatrixXd* rhs) const {
  const std::vector<int>& points = wanted_.function_points;
  Eigen::MatrixXd own = Eigen::MatrixXd::Zero(rhs->cols(), rhs->cols());
  std::map<int, std::vector<std::pair<Eigen::Index, Vector3>>> of_point;  // those that are not zero
  for (size_t p = 0; p < points.size(); ++p) {
    const int kept = layout().kept_block(points[p]);
    for (Eigen::Index k = 0; k < rhs->cols(); ++k) {
      const double* const from = &wanted_.functions_of_points[3 * (size_t(k) * points.size() + p)];
      const Eigen::Map<const Vector3> by_point(from);
      if (by_point.isZero(0)) continue;
      if (kept >= 0) rhs->col(k).segment<3>(layout().blocks()[kept].offset) += by_point;
      if (layout().point_is_free(points[p])) of_point[points[p]].emplace_back(k, by_point);
    }
  }
  std::vector<int> eliminated;
  for (const auto& [point, functions] : of_point) eliminated.push_back(point);
  system_.ForPoints(1, eliminated,
                    [&](int p, const PointBlocks& blocks, const PointAssembler&, int) {
                      const auto& functions = of_point.at(p);
                      for (const auto& [a, by_a] : functions) {
                        SubtractEliminated(blocks, by_a, rhs, static_cast<int>(a));
                        const Vector3 moved = Eigen::Map<const Matrix3>(blocks.inverse) * by_a;
                        for (const auto& [b, by_b] : functions) own(b, a) += by_b.dot(moved);
                      }
                    });
  return own;
}

void CovarianceComputation::FindRelative() {
  output_.relative.resize(36 * wanted_.relative.size());
  for (size_t k = 0; k < wanted_.relative.size(); ++k) {
    ThrowIfInterrupted();
    const auto [a, b] = wanted_.relative[k];
    Put(OfRelativePose(a, b, CovarianceTimes(UnknownsOfImage(a)),
                       CovarianceTimes(UnknownsOfImage(b))),
        k, &output_.relative);
  }
}

}  // namespace bundle
