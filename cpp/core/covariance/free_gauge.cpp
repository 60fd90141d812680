#include "core/covariance/free_gauge.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "core/dense/decompositions.h"

namespace bundle {
namespace {

/// Threshold for a singular value of J N relative to the parts of its rows. Rounding errors are
/// 1e-16 times a factor for scenes far from their centre. A prior with a sigma of a hundred times
/// the scene gives about 1e-8.
constexpr double kNull = 1e-11;

/// Adds J N of the rows without free points, to complete that of the problem.
GaugeTriangle SumUp(const ReducedSystem& system, const GaugeSums& sums) {
  GaugeTriangle total = sums.triangle();
  const SimilarityMoves& moves = sums.moves();
  system.ForObservationsOfFixedPoints(
      [&](const ObservationRows& rows) { sums.AddObservation(rows, &total); });
  system.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    const size_t columns = 3 * rows.points.size() + rows.unknowns.size();
    for (int row = 0; row < rows.num_rows; ++row) {
      const double* at = rows.jacobian.data() + row * columns;
      SimilarityRow by_cameras = SimilarityRow::Zero(), by_points = SimilarityRow::Zero();
      for (const int point : rows.points) {
        by_points += Eigen::Map<const Eigen::RowVector3d>(at).lazyProduct(moves.OfPoint(point));
        at += 3;
      }
      for (const int unknown : rows.unknowns) by_cameras += *at++ * moves.OfUnknown(unknown);
      total.Add(by_cameras, by_points);
    }
  });
  return total;
}

/// The combinations of the seven similarities that change no residual, 7 x degrees.
Eigen::MatrixXd FindFree(GaugeTriangle rows) {
  const SimilaritySquare triangle = rows.Triangle();
  // A similarity that moves no observed parameter is not counted: for instance, a scale without
  // points.
  std::vector<int> kept;
  for (int m = 0; m < kSimilarities; ++m) {
    if (rows.parts()[m] > 0) kept.push_back(m);
  }
  const auto count = static_cast<int>(kept.size());
  if (count == 0) return Eigen::MatrixXd(kSimilarities, 0);
  Eigen::VectorXd scale(count);
  Eigen::MatrixXd scaled(kSimilarities, count);
  for (int i = 0; i < count; ++i) {
    scale[i] = 1 / std::sqrt(rows.parts()[kept[i]]);
    scaled.col(i) = scale[i] * triangle.col(kept[i]);
  }
  const RightSingularVectors singular = DecomposeSingular(scaled);
  int degrees = 0;
  while (degrees < count && singular.values[count - 1 - degrees] < kNull) ++degrees;
  Eigen::MatrixXd free = Eigen::MatrixXd::Zero(kSimilarities, degrees);
  for (int i = 0; i < count; ++i) {
    free.row(kept[i]) = scale[i] * singular.vectors.row(i).tail(degrees);
  }
  return free;
}

/// Returns `degrees` unknowns in which the directions differ most, in units of their sigmas.
std::vector<int> ChooseHeld(const Eigen::MatrixXd& n, const std::vector<double>& diagonal) {
  const auto size = static_cast<Eigen::Index>(diagonal.size());
  Eigen::MatrixXd rows = n;
  for (Eigen::Index j = 0; j < size; ++j) rows.row(j) *= std::sqrt(std::max(diagonal[j], 0.0));
  std::vector<int> held;
  for (int d = 0; d < n.cols(); ++d) {
    Eigen::Index longest = 0;
    if (!(rows.rowwise().squaredNorm().maxCoeff(&longest) > 0)) break;
    held.push_back(static_cast<int>(longest));
    const Eigen::VectorXd direction = rows.row(longest).normalized();
    rows -= rows.lazyProduct(direction).eval().lazyProduct(direction.transpose());
  }
  return held;
}

/// Computes the sums for the gauge of a system without them.
GaugeSums SumPoints(const ReducedSystem& system) {
  GaugeSums sums(system.problem(), system.layout(), system.states(), system.num_threads());
  system.ForPoints([&](int point, const PointBlocks& blocks, const PointAssembler& rows,
                       int thread) { sums.AddPoint(point, blocks, rows, thread); });
  sums.Finish();
  return sums;
}

}  // namespace

FreeGauge::FreeGauge(const ReducedSystem& system)
    : system_(system), moves_(system.problem(), system.layout(), system.states()) {
  if (system.gauge_sums() != nullptr) {
    Take(*system.gauge_sums());
  } else {
    Take(SumPoints(system));
  }
}

void FreeGauge::Take(const GaugeSums& sums) {
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, kSimilarities, Eigen::RowMajor>;
  const Eigen::MatrixXd free = FindFree(SumUp(system_, sums));
  const int n = moves_.num_unknowns();
  Rows cameras(n, kSimilarities);
  for (int j = 0; j < n; ++j) cameras.row(j) = moves_.OfUnknown(j);
  Rows reduced = cameras - Eigen::Map<const Rows>(sums.eliminated().data(), n, kSimilarities);
  for (size_t j = 0; j < system_.held().size(); ++j) {
    if (system_.held()[j] != 0) reduced.row(static_cast<Eigen::Index>(j)).setZero();
  }
  cameras_ = Multiply(cameras, free);
  const Eigen::MatrixXd squares = MultiplyTransposed(cameras_, cameras_) +
                                  Multiply(MultiplyTransposed(free, sums.squares()), free);
  const Eigen::MatrixXd inverse = InverseOfCholesky(squares);
  combinations_ = Multiply(free, inverse);
  padded_.setZero();
  padded_.leftCols(degrees()) = combinations_;
  cameras_ = Multiply(cameras_, inverse);
  reduced_ = Multiply(reduced, combinations_);
  of_points_ = Multiply(MultiplyTransposed(combinations_, sums.weighted()), combinations_);
}

const NullPoint* FreeGauge::FindNullPoint(int point) const {
  const std::vector<NullPoint>& null = system_.null_points();
  const auto at = std::lower_bound(null.begin(), null.end(), point,
                                   [](const NullPoint& a, int b) { return a.point < b; });
  return at != null.end() && at->point == point ? &*at : nullptr;
}

FreeGauge::PointRows FreeGauge::OfPoint(int point) const {
  if (FindNullPoint(point) != nullptr) return PointRows::Zero(3, degrees());
  return moves_.OfPoint(point).lazyProduct(combinations_);
}

FreeGauge::PointRows FreeGauge::OfAnyPoint(int point) const {
  PointRows rows = moves_.OfPoint(point).lazyProduct(combinations_);
  if (const NullPoint* const null = FindNullPoint(point); null != nullptr) {
    rows -= (Eigen::Map<const Eigen::Matrix3d>(null->projector) * rows).eval();
  }
  return rows;
}

template <typename Left, typename Right>
void FreeGauge::Remove(const Left& left, const Right& right, FullVectors* x) const {
  const int n = moves_.num_unknowns(), num_points = system_.problem().num_points;
  Eigen::Map<Eigen::MatrixXd> cameras(x->cameras.data(), n, x->num_columns);
  Eigen::Map<Eigen::MatrixXd> points(x->points.data(), 3 * Eigen::Index{num_points},
                                     x->num_columns);
  Eigen::MatrixXd along = MultiplyTransposed(cameras_, cameras);
  const auto for_points = [&](const auto& visit) {
    for (int p = 0; p < num_points; ++p) {
      if (system_.layout().point_is_free(p)) visit(points.middleRows(3 * Eigen::Index{p}, 3), p);
    }
  };
  for_points([&](auto of_point, int p) { along += right(p).transpose().lazyProduct(of_point); });
  cameras -= Multiply(cameras_, along);
  for_points([&](auto of_point, int p) { of_point -= left(p).lazyProduct(along); });
}

void FreeGauge::Project(FullVectors* x) const {
  Remove([this](int p) { return OfAnyPoint(p); }, [this](int p) { return OfPoint(p); }, x);
}

void FreeGauge::ProjectTransposed(FullVectors* x) const {
  Remove([this](int p) { return OfPoint(p); }, [this](int p) { return OfAnyPoint(p); }, x);
}

Eigen::MatrixXd FreeGauge::HeldDirections() const {
  const std::vector<double>& diagonal = system_.diagonal();
  const auto size = static_cast<Eigen::Index>(diagonal.size());
  const Eigen::VectorXd root =
      Eigen::Map<const Eigen::VectorXd>(diagonal.data(), size).cwiseMax(0).cwiseSqrt();
  const Eigen::MatrixXd scaled = root.asDiagonal() * cameras_;
  return root.asDiagonal() * OrthonormalColumns(scaled);
}

void FreeGauge::Hold(ReducedSystem* system) const {
  const BlockStructure& s = system->structure();
  const std::vector<double>& diagonal = system->diagonal();
  if (s.dense) {
    const Eigen::MatrixXd b = HeldDirections();
    Eigen::Map<Eigen::MatrixXd>(system->values().data(), b.rows(), b.rows()) +=
        Multiply(b, b.transpose());
    return;
  }
  for (const int unknown : ChooseHeld(cameras_, diagonal)) {
    const int block = s.BlockOf(unknown);
    const int k = unknown - s.offset[block];
    system->values()[s.ValueIndex(block, s.Entry(block, block), k, k)] += diagonal[unknown];
  }
}

InnerConstraints::InnerConstraints(const FreeGauge& gauge, Eigen::MatrixXd y)
    : gauge_(gauge),
      y_(std::move(y)),
      k_(MultiplyTransposed(gauge.reduced(), y_) + gauge.of_points()) {}

void InnerConstraints::RowsOfUnknowns(int first, int count, double* n, double* y) const {
  for (int i = 0; i < count; ++i) {
    for (int m = 0; m < degrees(); ++m) {
      *n++ = gauge_.cameras()(first + i, m);
      *y++ = y_(first + i, m);
    }
  }
}

void InnerConstraints::Transform(int rows, const double* n_rows, const double* y_rows, int columns,
                                 const double* n_columns, const double* y_columns,
                                 double* block) const {
  using Map =
      Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;
  const int d = degrees();
  const Map ni(n_rows, rows, d), yi(y_rows, rows, d), nj(n_columns, columns, d),
      yj(y_columns, columns, d);
  Eigen::Map<Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(block, rows,
                                                                                     columns) +=
      ni.lazyProduct((k_.lazyProduct(nj.transpose()) - yj.transpose()).eval()) -
      yi.lazyProduct(nj.transpose());
}

void TransformBlocks(const Eigen::MatrixXd& n, const Eigen::MatrixXd& y, const Eigen::MatrixXd& k,
                     const BlockStructure& s, BlockValues* values) {
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  const Eigen::Index d = n.cols();
  // The change is left right^T, with left = [N | -Y] of the rows and right = [N k - Y | N] of the
  // columns of the block.
  Eigen::MatrixXd left(n.rows(), 2 * d);
  left << n, -y;
  Rows right(n.rows(), 2 * d);
  right << Multiply(n, k) - y, n;
  for (int j = 0; j < s.num_blocks(); ++j) {
    for (int64_t e = s.column_begin[j]; e < s.column_begin[j + 1]; ++e) {
      const int first = s.offset[s.row_block[e]], rows = s.block_size(s.row_block[e]);
      for (int c = 0; c < s.block_size(j); ++c) {
        double* const to = values->data() + s.ValueIndex(j, e, 0, c);
        const double* const by = right.row(s.offset[j] + c).data();
        for (Eigen::Index m = 0; m < 2 * d; ++m) {
          const double* const column = left.col(m).data() + first;
          for (int r = 0; r < rows; ++r) to[r] += by[m] * column[r];
        }
      }
    }
  }
}

}  // namespace bundle
