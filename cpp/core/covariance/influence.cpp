#include "core/covariance/influence.h"

#include <Eigen/Core>
#include <Eigen/Jacobi>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/covariance/covariance_computation.h"
#include "core/covariance/eliminated_rows.h"
#include "core/covariance/leverages.h"
#include "core/dense/decompositions.h"

namespace bundle {
namespace {

constexpr double kNotComputed = std::numeric_limits<double>::quiet_NaN();

/// Redundancy that is zero but for rounding: without the measurement, an unknown is undetermined.
constexpr double kNoRedundancy = 1e-9;

/// Redundancy above which the inverse takes no eigenvalues.
constexpr double kClearRedundancy = 1e-3;

/// Derivatives of the quantity along an unknown are zero below this share of its sigma.
constexpr double kNoChange = 1e-6;

/// (J~ a)^T (I - h)^+ r~ of an observation.
double WithoutObservation(const Eigen::Matrix2d& h, const Eigen::Vector2d& along,
                          const Eigen::Vector2d& residual, double sigma) {
  const double off = 0.5 * (h(0, 1) + h(1, 0));
  const double r00 = 1 - h(0, 0), r11 = 1 - h(1, 1), determinant = r00 * r11 - off * off;
  if (determinant > kClearRedundancy * (r00 + r11)) {  // so that both eigenvalues are above
    return (along[0] * (r11 * residual[0] + off * residual[1]) +
            along[1] * (off * residual[0] + r00 * residual[1])) /
           determinant;
  }
  Eigen::JacobiRotation<double> turn;
  turn.makeJacobi(h(0, 0), off, h(1, 1));
  const double moved = off == 0 ? 0 : turn.s() / turn.c() * off;
  const double redundancies[2] = {1 - h(0, 0) + moved, 1 - h(1, 1) - moved};
  const Eigen::Vector2d axes[2] = {{turn.c(), -turn.s()}, {turn.s(), turn.c()}};
  double change = 0;
  for (int k = 0; k < 2; ++k) {
    const double by = along.dot(axes[k]);
    if (redundancies[k] > kNoRedundancy) {
      change += by * residual.dot(axes[k]) / redundancies[k];
    } else if (std::abs(by) > kNoChange * sigma) {
      return kNotComputed;
    }
  }
  return change;
}

/// (T a_c)^T (I - T C T^T)^-1 r~ of all observations of a point.
double WithoutPoint(const Eigen::MatrixXd& leverages, const Eigen::VectorXd& along,
                    const Eigen::VectorXd& residual) {
  const Eigen::Index size = leverages.rows();
  Eigen::VectorXd solved;
  const bool is_certain = SolveByCholesky(Eigen::MatrixXd::Identity(size, size) - leverages,
                                          residual, kNoRedundancy, &solved);
  return is_certain ? along.dot(solved) : kNotComputed;
}

}  // namespace

/// g_c, by the maps of the images and the points that are not eliminated; a camera's part by its
/// first observed image.
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
  for (const int p : layout().kept_points()) {
    gradient.col(0).segment<3>(layout().blocks()[layout().kept_block(p)].offset) =
        Eigen::Map<const Vector3>(&wanted.points[3 * size_t(p)]);
  }
  return gradient;
}

void CovarianceComputation::FindInfluence(const InfluenceOptions& gradient, Deletions wanted,
                                          InfluenceOutput* found) {
  if (is_small_) system_.EliminateByRows();
  HoldGauge();
  CountResiduals();
  Factorize();
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
  // The adjoint, and the points' part of the variance.
  Eigen::MatrixXd rhs = given, a = Eigen::MatrixXd::Zero(given.rows(), 1);
  system_.ForPoints(1, points, [&](int p, const PointBlocks& blocks, const PointAssembler&, int) {
    SubtractEliminated(blocks, of_point(p), &rhs, 0);
    found->variance += of_point(p).dot(Eigen::Map<const Matrix3>(blocks.inverse) * of_point(p));
  });
  Check(system_.Solve(rhs.data(), 1, a.data()));
  found->variance += rhs.col(0).dot(a.col(0));
  const double sigma = std::sqrt(found->variance);
  const LongMatrix inverse = wanted == Deletions::kNone ? LongMatrix() : LongInverse();
  InvertAndCheck();

  const auto n = static_cast<size_t>(view().num_observations);
  const auto num_points = static_cast<size_t>(view().num_points);
  found->along.assign(2 * n, kNotComputed);
  found->weights.assign(n, kNotComputed);
  if (wanted == Deletions::kObservations) found->without.assign(n, kNotComputed);
  if (wanted == Deletions::kPoints) found->without.assign(num_points, kNotComputed);
  std::vector<double> steps(n);               // a sum that no thread changes
  std::vector<double> moved(3 * num_points);  // a_p
  const auto along_of = [&](const ObservationRows& rows) {
    const int point = view().observation_point[rows.observation];
    Eigen::Vector2d along = Eigen::Map<const TwoRows>(rows.point, 2, 3) *
                            Eigen::Map<const Vector3>(&moved[3 * size_t(point)]);
    for (int b = 0; b < rows.num_blocks; ++b) {
      along += RowsByBlock(rows, b) *
               a.col(0).segment(layout().blocks()[rows.block[b]].offset, rows.size[b]);
    }
    return along;
  };
  const auto take = [&](const Leverage& of) {
    const auto i = static_cast<size_t>(of.observation);
    const Eigen::Vector2d along =
        of.rows != nullptr ? along_of(*of.rows) : Eigen::Vector2d(of.along[0], of.along[1]);
    const Eigen::Map<const Eigen::Vector2d> residual(of.residual);
    std::copy_n(along.data(), 2, &found->along[2 * i]);
    found->weights[i] = of.weight;
    steps[i] = -along.dot(residual);
    if (wanted != Deletions::kObservations || !(of.weight > 0)) return;
    found->without[i] = WithoutObservation(of.h, along, residual, sigma);
  };
  const auto take_point = [&](int p, const PointBlocks& blocks, const PointAssembler& rows,
                              const PointLeverages& leverages) {
    Vector3 by_point = Eigen::Map<const Matrix3>(blocks.inverse) * of_point(p);
    for (size_t b = 0; b < blocks.blocks.size(); ++b) {
      const double* of_unknown = &a(layout().blocks()[blocks.blocks[b]].offset, 0);
      for (int row = blocks.begin[b]; row < blocks.begin[b + 1]; ++row) {
        by_point -= Eigen::Map<const Vector3>(&blocks.y[3 * size_t(row)]) * *of_unknown++;
      }
    }
    std::copy_n(by_point.data(), 3, &moved[3 * size_t(p)]);
    const int size = 2 * rows.num_rows();
    if (wanted != Deletions::kPoints || size == 0 || !of_point(p).isZero(0)) return;
    Eigen::VectorXd along(size), residual(size);
    for (int i = 0; i < rows.num_rows(); ++i) {
      along.segment<2>(2 * i) = along_of(rows.row(i));
      std::copy_n(rows.row(i).residual, 2, residual.data() + 2 * i);
    }
    found->without[p] = WithoutPoint(leverages.OfCameras(), along, residual);
  };
  LeverageOptions of_leverages;
  of_leverages.without_h = wanted != Deletions::kObservations;
  of_leverages.of_points = wanted == Deletions::kPoints;
  of_leverages.adjoint = a.data();
  of_leverages.points = std::move(points);
  system_.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    of_leverages.points.insert(of_leverages.points.end(), rows.points.begin(), rows.points.end());
  });
  if (is_small_ || wanted == Deletions::kPoints) of_leverages.points = system_.free_points();
  ForLeverages(system_, inverse, take, take_point, of_leverages);
  for (const double step : steps) found->step += step;
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
  found->sums = std::move(output_);
}

InfluenceOutput ComputeInfluence(const AdjustmentProblem& problem, const SolveOptions& options,
                                 const InfluenceOptions& gradient, Deletions wanted) {
  SolveOptions all = options;
  all.gauge = Gauge::kNone;
  const CovarianceOptions of_inverse;
  InfluenceOutput found;
  CovarianceComputation(problem, all, of_inverse).FindInfluence(gradient, wanted, &found);
  return found;
}

}  // namespace bundle
