#include "core/covariance/leverages.h"

#include <Eigen/Core>
#include <Eigen/Jacobi>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <utility>
#include <vector>

#include "core/covariance/eliminated_rows.h"
#include "core/error.h"

namespace bundle {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;

/// Per observation, so that sums do not depend on threads.
struct Found {
  explicit Found(size_t count)
      : scores(2 * count), m(2 * count), known(count), rest(count), squares(count) {}

  std::vector<double> scores;   ///< r^
  std::vector<double> m;        ///< m, zero along full leverage
  std::vector<double> known;    ///< tr h without full leverage
  std::vector<double> rest;     ///< 2 - tr h; 0 if rho' = 0
  std::vector<double> squares;  ///< ||rho' r||^2
  std::atomic<bool> has_bends{false};
};

/// Takes the eigenvalues of h, and all that follows from them. One Jacobi rotation diagonalises a
/// symmetric matrix of two rows.
void Take(const Matrix2d& h, const ObservationRows& rows, Found* found) {
  const auto i = static_cast<size_t>(rows.observation);
  const double off = 0.5 * (h(0, 1) + h(1, 0));
  Eigen::JacobiRotation<double> turn;
  turn.makeJacobi(h(0, 0), off, h(1, 1));
  Matrix2d axes;
  axes << turn.c(), turn.s(), -turn.s(), turn.c();
  const double moved = off == 0 ? 0 : turn.s() / turn.c() * off;
  const Vector2d eigenvalues(h(0, 0) - moved, h(1, 1) + moved);
  const Eigen::Map<const Vector2d> r(rows.residual);
  const Vector2d along = axes.transpose() * r;
  Vector2d scaled = Vector2d::Zero(), k = Vector2d::Zero();
  for (int axis = 0; axis < 2; ++axis) {
    const double of = std::max(eigenvalues[axis], 0.0), rest = 1 - of;
    if (rest <= kFullLeverage) continue;
    scaled[axis] = along[axis] / std::sqrt(rest);
    k[axis] = of / rest;
    found->known[i] += of;
  }
  Eigen::Map<Vector2d>(&found->scores[2 * i]) = axes * scaled;
  found->squares[i] = rows.weight * r.squaredNorm();
  if (rows.weight > 0) found->rest[i] = 2 - h.trace();
  if (rows.bend != 0) found->has_bends.store(true, std::memory_order_relaxed);
  // The eigenvalues of K + bend q q^T with q = K^(1/2) r.
  const Vector2d q = k.cwiseSqrt().cwiseProduct(along);
  const double a = k[0] + rows.bend * q[0] * q[0], b = rows.bend * q[0] * q[1];
  const double c = k[1] + rows.bend * q[1] * q[1];
  const double mean = 0.5 * (a + c), half = std::hypot(0.5 * (a - c), b);
  found->m[2 * i] = mean - half;
  found->m[2 * i + 1] = mean + half;
}

double Sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

/// sum m / (kappa + m), `flat`: of positive m only.
double Determined(const std::vector<double>& m, double kappa, bool flat) {
  double sum = 0;
  for (const double value : m) sum += flat && value < 0 ? 0 : value / (kappa + value);
  return sum;
}

/// The largest root of Determined(kappa) = known in (least, 1]; 0 if there is none. Looks for a
/// change of sign in steps of kStep, and bisects.
double LargestRoot(const std::vector<double>& m, double known, double least, bool flat) {
  constexpr double kStep = 0.95;
  double above = 1;
  if (least >= above) return 0;
  while (Determined(m, above, flat) < known) {
    const double next = kStep * above;
    if (next <= least) return 0;
    if (Determined(m, next, flat) < known) {
      above = next;
      continue;
    }
    double below = next;
    while (above - below > 1e-14) {
      const double middle = 0.5 * (above + below);
      (Determined(m, middle, flat) < known ? above : below) = middle;
    }
    return below;
  }
  return above;
}

double FindCurvature(const Found& found) {
  if (!found.has_bends) return 1;
  const double known = Sum(found.known);
  const double least = -*std::min_element(found.m.begin(), found.m.end());
  double kappa = LargestRoot(found.m, known, std::max(least, kLeastCurvature), false);
  if (kappa == 0) kappa = LargestRoot(found.m, known, kLeastCurvature, true);
  if (kappa > 0) return kappa;
  throw InputError(
      "robust: expected a loss that lets enough observations count for a sandwich, found most of "
      "them beyond its scale; use a larger loss_scale or weights");
}

/// Leverages of the observations of one point, or of none, from blocks of C.
template <typename Scalar>
class Leverages {
 public:
  using Block = Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic>;
  using Block2 = Eigen::Matrix<Scalar, 2, 2>;
  using Rows3 = Eigen::Matrix<Scalar, Eigen::Dynamic, 3>;

  Leverages(const ReducedSystem& system, const LongMatrix& inverse)
      : system_(system), inverse_(inverse) {}

  /// A C A^T
  Matrix2d OfCameras(const ObservationRows& rows) const {
    return Own(rows).template cast<double>();
  }

  /// C Y and V^-1 + Y^T C Y of a point
  void TakePoint(const PointBlocks& blocks) {
    using RowMajor3 = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
    const Rows3 y = Eigen::Map<const RowMajor3>(blocks.y.data(), blocks.begin.back(), 3)
                        .template cast<Scalar>();
    cy_ = Rows3::Zero(y.rows(), 3);
    for (size_t a = 0; a < blocks.blocks.size(); ++a) {
      for (size_t b = 0; b < blocks.blocks.size(); ++b) {
        const Block block = BlockOf(blocks.blocks[a], blocks.blocks[b]);
        cy_.middleRows(blocks.begin[a], block.rows()) +=
            block.lazyProduct(y.middleRows(blocks.begin[b], block.cols()));
      }
    }
    of_point_ = Eigen::Map<const Eigen::Matrix3d>(blocks.inverse).template cast<Scalar>() +
                y.transpose().lazyProduct(cy_);
  }

  /// h, with the products of T C T^T multiplied out
  Matrix2d OfPoint(const PointBlocks& blocks, const ObservationRows& rows) const {
    const Eigen::Matrix<Scalar, 2, 3> b =
        Eigen::Map<const TwoRows>(rows.point, 2, 3).template cast<Scalar>();
    Block2 cross = Block2::Zero();  // A C Y B^T
    for (int k = 0; k < rows.num_blocks; ++k) {
      const auto at = std::lower_bound(blocks.blocks.begin(), blocks.blocks.end(), rows.block[k]);
      const Eigen::Matrix<Scalar, 2, 3> acy = Rows(rows, k).lazyProduct(
          cy_.middleRows(blocks.begin[at - blocks.blocks.begin()], rows.size[k]));
      cross += acy.lazyProduct(b.transpose());
    }
    const Eigen::Matrix<Scalar, 2, 3> by_point = b.lazyProduct(of_point_);
    const Block2 h = Own(rows) + by_point.lazyProduct(b.transpose()) - cross - cross.transpose();
    return h.template cast<double>();
  }

 private:
  static Block Rows(const ObservationRows& rows, int k) {
    return RowsByBlock(rows, k).template cast<Scalar>();
  }

  Block BlockOf(int row, int column) const {
    const std::vector<CameraBlock>& blocks = system_.layout().blocks();
    const CameraBlock &to = blocks[row], &from = blocks[column];
    if (inverse_.size() > 0) {
      return inverse_.block(to.offset, from.offset, to.size, from.size).template cast<Scalar>();
    }
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> block(to.size,
                                                                                 from.size);
    system_.CopyBlock(system_.values(), row, column, block.data());
    return block.template cast<Scalar>();
  }

  Block2 Own(const ObservationRows& rows) const {
    Block2 sum = Block2::Zero();
    for (int a = 0; a < rows.num_blocks; ++a) {
      for (int b = 0; b < rows.num_blocks; ++b) {
        const Block left = Rows(rows, a).lazyProduct(BlockOf(rows.block[a], rows.block[b]));
        sum += left.lazyProduct(Rows(rows, b).transpose());
      }
    }
    return sum;
  }

  const ReducedSystem& system_;
  const LongMatrix& inverse_;
  Rows3 cy_;
  Eigen::Matrix<Scalar, 3, 3> of_point_ = Eigen::Matrix<Scalar, 3, 3>::Zero();
};

template <typename Scalar>
void FindLeverages(const ReducedSystem& system, const LongMatrix& inverse, Found* found) {
  std::vector<Leverages<Scalar>> of_thread(system.num_threads(), {system, inverse});
  system.ForPoints([&](int, const PointBlocks& blocks, const PointAssembler& rows, int thread) {
    Leverages<Scalar>& leverages = of_thread[thread];
    leverages.TakePoint(blocks);
    for (int i = 0; i < rows.num_rows(); ++i) {
      Take(leverages.OfPoint(blocks, rows.row(i)), rows.row(i), found);
    }
  });
  system.ForObservationsOfFixedPoints(
      [&](const ObservationRows& rows) { Take(of_thread[0].OfCameras(rows), rows, found); });
}

}  // namespace

CorrectedResiduals CorrectForLeverage(const ReducedSystem& system, const LongMatrix& inverse) {
  Found found(static_cast<size_t>(system.problem().num_observations));
  if (inverse.size() > 0) {
    FindLeverages<long double>(system, inverse, &found);
  } else {
    FindLeverages<double>(system, inverse, &found);
  }
  CorrectedResiduals corrected;
  const double rest = Sum(found.rest);
  if (rest > kFullLeverage) corrected.variance = Sum(found.squares) / rest;
  corrected.kappa = FindCurvature(found);
  corrected.scores = std::move(found.scores);
  return corrected;
}

}  // namespace bundle
