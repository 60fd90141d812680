#include "core/covariance/influence.h"

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/covariance/covariance_computation.h"
#include "core/covariance/eliminated_rows.h"
#include "core/dense/decompositions.h"

namespace bundle {
namespace {

constexpr double kNotComputed = std::numeric_limits<double>::quiet_NaN();

/// Pivots below this are zero: without the point, camera parameters are undetermined.
constexpr double kNoRedundancy = 1e-9;

}  // namespace

/// g_c, by the maps of the images; a camera's part by its first observed image.
Eigen::MatrixXd CovarianceComputation::GradientOfCameras(const InfluenceOptions& wanted) const {
  Eigen::MatrixXd gradient = Eigen::MatrixXd::Zero(system_.num_unknowns(), 1);
  const int stride = view().camera_params_stride;
  std::vector<uint8_t> is_done(view().num_cameras);
  const std::vector<uint8_t> is_observed = FindObservedImages(view());
  for (int i = 0; i < view().num_images; ++i) {
    Eigen::VectorXd local = Eigen::VectorXd::Zero(kLocal);
    local.head<6>() = Eigen::Map<const Eigen::Matrix<double, 6, 1>>(&wanted.images[6 * size_t(i)]);
    if (centered_.is_moved()) local.head<6>() = MapBack(i).transpose() * local.head<6>();
    const int camera = view().image_camera[i];
    if (is_observed[i] != 0 && is_done[camera] == 0) {
      is_done[camera] = 1;
      std::copy_n(&wanted.cameras[size_t(camera) * stride], std::min(stride, kMaxCameraParams),
                  local.data() + kPoseSize);
    }
    for (const LocalMap& map : system_.evaluator().maps(i)) {
      gradient.col(0).segment(layout().blocks()[map.block].offset, map.size) +=
          WholeMap(map).transpose().lazyProduct(local);
    }
  }
  return gradient;
}

void CovarianceComputation::FindInfluence(const InfluenceOptions& gradient,
                                          const ReliabilityOptions& wanted,
                                          InfluenceOutput* found) {
  if (is_small_) system_.EliminateByRows();
  HoldGauge();
  CountResiduals();
  Factorize();
  const auto n = static_cast<size_t>(view().num_observations);
  const auto of_point = [&](int p) {
    return Vector3(Eigen::Map<const Vector3>(&gradient.points[3 * size_t(p)]));
  };
  const Eigen::MatrixXd given = GradientOfCameras(gradient);
  std::vector<int> points;
  for (int p = 0; p < view().num_points; ++p) {
    if (layout().point_is_free(p) && !of_point(p).isZero(0)) points.push_back(p);
  }
  const FreeGauge& gauge = *gauge_;
  if (gauge.degrees() > 0) {
    Eigen::VectorXd along = MultiplyTransposed(gauge.cameras(), given.col(0));
    Eigen::VectorXd terms = MultiplyTransposed(gauge.cameras().cwiseAbs(), given.col(0).cwiseAbs());
    for (const int p : points) {
      along += gauge.OfPoint(p).transpose().lazyProduct(of_point(p));
      terms += gauge.OfPoint(p).cwiseAbs().transpose().lazyProduct(of_point(p).cwiseAbs());
    }
    found->gauge_share = terms.isZero(0) ? 0 : along.norm() / terms.norm();
  }
  // The adjoint.
  Eigen::MatrixXd rhs = given, a = Eigen::MatrixXd::Zero(given.rows(), 1);
  system_.ForPoints(1, points, [&](int p, const PointBlocks& blocks, const PointAssembler&, int) {
    SubtractEliminated(blocks, of_point(p), &rhs, 0);
  });
  Check(system_.Solve(rhs.data(), 1, a.data()));
  LongMatrix inverse;
  if (is_small_) {
    inverse.setIdentity(lower_.rows(), lower_.cols());
    SolveLong(lower_, &inverse);
  }
  InvertAndCheck();
  FindLeverages(inverse, wanted, &found->reliability);

  found->along.assign(2 * n, kNotComputed);
  found->without_point.assign(view().num_points, kNotComputed);
  const auto num_points = static_cast<size_t>(view().num_points);
  std::vector<double> variances(num_points), steps(n);  // sums that no thread changes
  std::vector<double> moved(3 * num_points);            // a_p
  const auto take = [&](const ObservationRows& rows, const Vector3& by_point) {
    const auto i = static_cast<size_t>(rows.observation);
    Eigen::Vector2d along = Eigen::Map<const TwoRows>(rows.point, 2, 3) * by_point;
    for (int b = 0; b < rows.num_blocks; ++b) {
      along += RowsByBlock(rows, b) *
               a.col(0).segment(layout().blocks()[rows.block[b]].offset, rows.size[b]);
    }
    const Eigen::Map<const Eigen::Vector2d> r(rows.residual);
    std::copy_n(along.data(), 2, &found->along[2 * i]);
    steps[i] = -along.dot(r);
  };
  system_.ForPoints([&](int p, const PointBlocks& blocks, const PointAssembler& rows, int) {
    Vector3 by_point = Eigen::Map<const Matrix3>(blocks.inverse) * of_point(p);
    variances[p] = of_point(p).dot(by_point);
    std::vector<int> unknowns;
    for (size_t b = 0; b < blocks.blocks.size(); ++b) {
      const int offset = layout().blocks()[blocks.blocks[b]].offset;
      for (int row = blocks.begin[b]; row < blocks.begin[b + 1]; ++row) {
        unknowns.push_back(offset + row - blocks.begin[b]);
        by_point -= Eigen::Map<const Vector3>(&blocks.y[3 * size_t(row)]) * a(unknowns.back(), 0);
      }
    }
    std::copy_n(by_point.data(), 3, &moved[3 * size_t(p)]);
    for (int i = 0; i < rows.num_rows(); ++i) take(rows.row(i), by_point);
    if (rows.num_rows() == 0 || !of_point(p).isZero(0)) return;
    // A and B of all observations, by the unknowns of the point's blocks.
    const Eigen::MatrixXd all = AllRows(
        blocks, rows, {}, [](const ObservationRows&) { return Eigen::Matrix2d::Identity(); });
    using Rows3 = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
    const Eigen::Map<const Rows3> y(blocks.y.data(), blocks.begin.back(), 3);
    const Eigen::MatrixXd t =
        all.rightCols(y.rows()) - all.leftCols<3>().lazyProduct(y.transpose());
    Eigen::VectorXd along(t.rows()), r(t.rows());
    for (int i = 0; i < rows.num_rows(); ++i) {
      std::copy_n(rows.row(i).residual, 2, r.data() + 2 * i);
      std::copy_n(&found->along[2 * size_t(rows.row(i).observation)], 2, along.data() + 2 * i);
    }
    const Eigen::MatrixXd h = Multiply(Multiply(t, CovarianceOf(unknowns, inverse)), t.transpose());
    const Eigen::LLT<Eigen::MatrixXd> factor(Eigen::MatrixXd::Identity(h.rows(), h.cols()) - h);
    if (factor.info() != Eigen::Success) return;
    if (factor.matrixLLT().diagonal().cwiseAbs2().minCoeff() < kNoRedundancy) return;
    found->without_point[p] = along.dot(factor.solve(r));
  });
  system_.ForObservationsOfFixedPoints(
      [&](const ObservationRows& rows) { take(rows, Vector3::Zero()); });
  for (const double step : steps) found->step += step;
  found->variance = rhs.col(0).dot(a.col(0));
  for (const double variance : variances) found->variance += variance;
  const size_t m = view().factors == nullptr ? 0 : view().factors->factors.size();
  found->factor_share.assign(m, kNotComputed);
  system_.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    Eigen::VectorXd x(static_cast<Eigen::Index>(3 * rows.points.size() + rows.unknowns.size()));
    Eigen::Index at = 0;
    for (const int point : rows.points) {
      for (int k = 0; k < 3; ++k) x[at++] = moved[3 * size_t(point) + k];
    }
    for (const int unknown : rows.unknowns) x[at++] = a(unknown, 0);
    const Eigen::Map<const Matrix> j(rows.jacobian.data(), rows.num_rows, x.size());
    const Eigen::VectorXd along = j.lazyProduct(x);
    found->factor_share[rows.factor] = along.squaredNorm();
    found->step -=
        along.dot(Eigen::Map<const Eigen::VectorXd>(rows.residual.data(), rows.num_rows));
  });
  for (const NullPoint& null : system_.null_points()) output_.null_points.push_back(null.point);
  output_.warnings = system_.warnings();
  found->reliability.sums = std::move(output_);
}

InfluenceOutput ComputeInfluence(const AdjustmentProblem& problem, const SolveOptions& options,
                                 const InfluenceOptions& gradient,
                                 const ReliabilityOptions& wanted) {
  SolveOptions all = options;
  all.gauge = Gauge::kNone;
  CovarianceOptions of_inverse;
  of_inverse.long_sums = wanted.long_sums;
  InfluenceOutput found;
  CovarianceComputation(problem, all, of_inverse).FindInfluence(gradient, wanted, &found);
  return found;
}

}  // namespace bundle
