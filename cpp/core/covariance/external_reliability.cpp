/// Part of CovarianceComputation (covariance_computation.h): what undetected errors move.

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "core/covariance/covariance_computation.h"
#include "core/covariance/point_pairs.h"
#include "core/covariance/reliability.h"
#include "core/dense/decompositions.h"

namespace bundle {
namespace {

/// Eigenvalues below this share of the largest one are rounding errors.
constexpr double kNoVariance = 1e-12;

/// Movements in one pass over the points, beside the seven columns of a gauge.
constexpr int kAtOnce = Kernels::kMostMoved - kSimilarities;

/// C^+ of a covariance, whose rank is found in units of its sigmas.
Eigen::MatrixXd PseudoInverse(const Eigen::MatrixXd& covariance) {
  const Eigen::VectorXd sigmas = covariance.diagonal().cwiseMax(0).cwiseSqrt();
  const Eigen::VectorXd scale = sigmas.unaryExpr([](double s) { return s > 0 ? 1 / s : 0; });
  const SymmetricEigen of =
      DecomposeSymmetric(scale.asDiagonal() * covariance * scale.asDiagonal());
  const double least = kNoVariance * of.values[of.values.size() - 1];
  const Eigen::VectorXd inverse =
      of.values.unaryExpr([least](double v) { return v > least ? 1 / v : 0; });
  const Eigen::MatrixXd scaled = scale.asDiagonal() * of.vectors;
  return Multiply(scaled * inverse.asDiagonal(), scaled.transpose());
}

/// x^T A x of the columns x of three rows, `width` registers wide, for a symmetric A.
BUNDLE_FOR_TWO_PROCESSORS
void FindSquares(const double* a, const double* rows, int width, double* squares) {
  const Four* const x = reinterpret_cast<const Four*>(rows);
  Four* const to = reinterpret_cast<Four*>(squares);
  for (int w = 0; w < width; ++w) {
    Four sum = {};
    for (int i = 0; i < 3; ++i) {
      Four row = {};
      for (int k = 0; k < 3; ++k) row += a[3 * i + k] * x[width * k + w];
      sum += row * x[width * i + w];
    }
    to[w] = sum;
  }
}

}  // namespace

/// The observations of the least redundancy that is not below the limit; ties by index.
void CovarianceComputation::FindWorst(const ReliabilityOptions& wanted,
                                      ReliabilityOutput* found) const {
  std::vector<std::pair<double, int64_t>> candidates;
  for (int64_t i = 0; i < view().num_observations; ++i) {
    if (found->least[i] >= wanted.least) candidates.emplace_back(found->least[i], i);
  }
  const size_t count = std::min(candidates.size(), size_t(wanted.num_worst));
  std::partial_sort(candidates.begin(), candidates.begin() + static_cast<std::ptrdiff_t>(count),
                    candidates.end());
  for (size_t k = 0; k < count; ++k) {
    found->worst.push_back({});
    found->worst.back().observation = candidates[k].second;
  }
}

/// J~^T u / sqrt(l) of each of these observations is b, and x = G b with any inverse G of a gauge:
///
///   x_c = C (b_c - Y_q b_q) with q its own point,      x_p = V_p^-1 b_p - Y_p^T x_c.
///
/// Inner constraints subtract N s, with s = N^T x = K^T x_c + w and w = N_q^T V_q^-1 b_q
/// (free_gauge.h). As -Y_p^T N_c = N_p, only from x_c.
///
/// Another point p is -Y_p^T c + e_p, with the cameras' errors c, of covariance C, and independent
/// ones e of the points, of V^-1; x_p is its covariance with (b_c - Y_q b_q)^T c + b_q^T e_q. Inner
/// constraints subtract N_p sum N_r^T e_r, too. The parts by c and by e are independent, z^T M^-1 z
/// of a sum is at most the sum of both, and by e, M >= N_p (A - A_p) N_p^T with A = sum A_r and
/// A_r = N_r^T V_r^-1 N_r. So p moves by at most the root of
///
///   (b_c - Y_q b_q)^T C (b_c - Y_q b_q) + w^T (A - A_p)^-1 w       sigmas.
///
/// Mostly, q moves by more. The other points are looked at for the rest of the errors only.
void CovarianceComputation::FindEffects(BlockValues inverse, ReliabilityOutput* found) {
  const int count = static_cast<int>(found->worst.size()), n = system_.num_unknowns();
  if (count == 0) return;
  const int degrees = constraints_ == nullptr ? 0 : gauge_->degrees();
  Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(n, count), x = rhs;
  Eigen::MatrixXd own = Eigen::MatrixXd::Zero(3, count);  // V_q^-1 b_q
  Eigen::MatrixXd s = Eigen::MatrixXd::Zero(degrees, count);
  for (int k = 0; k < count; ++k) {
    ObservationRows rows;
    const int64_t i = found->worst[k].observation;
    system_.evaluator().Evaluate(i, &rows);
    const double length = 1 / std::sqrt(found->least[i]);
    const double u[2] = {length * found->along[2 * i], length * found->along[2 * i + 1]};
    for (int b = 0; b < rows.num_blocks; ++b) {
      const int offset = layout().blocks()[rows.block[b]].offset;
      for (int c = 0; c < rows.size[b]; ++c) {
        rhs(offset + c, k) +=
            u[0] * rows.jacobian[b][c] + u[1] * rows.jacobian[b][rows.size[b] + c];
      }
    }
    const int point = view().observation_point[i];
    if (!layout().point_is_free(point)) continue;  // an unknown among those above, or constant
    Vector3 of_point;
    for (int c = 0; c < 3; ++c) of_point[c] = u[0] * rows.point[c] + u[1] * rows.point[3 + c];
    system_.ForPoints(1, {point}, [&](int, const PointBlocks& blocks, const PointAssembler&, int) {
      SubtractEliminated(blocks, of_point, &rhs, k);
      own.col(k) = Eigen::Map<const Matrix3>(blocks.inverse) * of_point;
      if (degrees > 0) s.col(k) += gauge_->OfPoint(point).transpose().lazyProduct(own.col(k));
    });
  }
  Check(system_.Solve(rhs.data(), count, x.data()));
  std::vector<int> by_rows;
  std::vector<uint8_t> is_in_lanes(view().num_points);
  for (const int p : PointsBeside(*found)) {
    is_in_lanes[p] = std::isnan(output_.points[9 * size_t(p)]) ? 0 : 1;
    if (is_in_lanes[p] == 0) by_rows.push_back(p);
  }
  Eigen::RowVectorXd others = rhs.cwiseProduct(x).colwise().sum();  // the squares of these bounds
  if (degrees > 0) {
    const Eigen::MatrixXd root = InverseOfCholesky(gauge_->of_points());
    const double rest = 1 - LargestShare(is_in_lanes, root);
    others += MultiplyTransposed(root, s).colwise().squaredNorm() / std::max(rest, 0.0);
    s += MultiplyTransposed(gauge_->reduced(), x);
  }
  Matrix moved = x;
  if (degrees > 0) moved -= Multiply(gauge_->cameras(), s);
  for (int i = 0; i < view().num_images; ++i) {
    const Matrix6 covariance = Eigen::Map<const Matrix6>(&output_.poses[36 * size_t(i)]);
    if (!(covariance.trace() > 0)) continue;
    const Eigen::MatrixXd weight = PseudoInverse(covariance);
    Matrix rows = LocalRows(i, moved);
    if (centered_.is_moved()) rows = MapBack(i).lazyProduct(rows).eval();
    for (int k = 0; k < count; ++k) {
      const double sigmas = std::sqrt(rows.col(k).dot(weight.lazyProduct(rows.col(k))));
      ExternalEffect& effect = found->worst[k];
      if (!(sigmas > effect.image_sigmas)) continue;
      effect.image = i;
      effect.image_sigmas = sigmas;
    }
  }
  std::swap(system_.values(), inverse);
  std::vector<int> effects(count), open;
  for (int k = 0; k < count; ++k) {
    effects[k] = k;
    const int point = view().observation_point[found->worst[k].observation];
    if (is_in_lanes[point] != 0) by_rows.push_back(point);
  }
  std::sort(by_rows.begin(), by_rows.end());
  by_rows.erase(std::unique(by_rows.begin(), by_rows.end()), by_rows.end());
  const auto move = [&](const std::vector<int>& all, const std::vector<int>& in_rows,
                        const std::vector<uint8_t>& in_lanes) {
    for (auto first = all.begin(); first != all.end();) {
      const auto last = first + std::min<std::ptrdiff_t>(all.end() - first, kAtOnce);
      MovePoints({first, last}, moved, own, in_rows, in_lanes, found);
      first = last;
    }
  };
  move(effects, by_rows, {});
  for (const int k : effects) {
    const double sigmas = found->worst[k].point_sigmas;
    if (!(sigmas * sigmas > others[k])) open.push_back(k);
  }
  move(open, {}, is_in_lanes);
}

/// At least the largest eigenvalue of A^-1 A_p, with R R^T = A^-1: the trace, with the covariances
/// that the leverages have left, which are above V_p^-1.
double CovarianceComputation::LargestShare(const std::vector<uint8_t>& is_wanted,
                                           const Eigen::MatrixXd& root) const {
  using Square = Eigen::Matrix<double, kSimilarities, kSimilarities, Eigen::RowMajor>;
  Square by_moves = Square::Zero();
  by_moves.leftCols(gauge_->degrees()) =
      Eigen::Map<const Eigen::Matrix<double, kSimilarities, kMoves, Eigen::RowMajor>>(
          gauge_->combinations())
          .leftCols(gauge_->degrees())
          .lazyProduct(root);
  double largest = 0;
  for (int p = 0; p < view().num_points; ++p) {
    if (is_wanted[p] == 0) continue;
    const Eigen::Matrix<double, 3, kSimilarities, Eigen::RowMajor> n =
        gauge_->moves().OfPoint(p).lazyProduct(by_moves);
    const Eigen::Map<const Matrix3> covariance(&output_.points[9 * size_t(p)]);
    largest = std::max(largest, n.cwiseProduct(covariance.lazyProduct(n)).sum());
  }
  return largest;
}

/// Judges the movements of points with some errors, which move the unknowns by columns of x, and
/// keeps those larger than known ones. The pass in lanes also gives the points' part
/// V_p^-1 N_p - Y_p^T y of Y = G N (free_gauge.h), which transforms the covariances that the
/// leverages have left. Points by rows are transformed by blocks.
void CovarianceComputation::MovePoints(const std::vector<int>& effects, const Matrix& x,
                                       const Eigen::MatrixXd& own, const std::vector<int>& by_rows,
                                       const std::vector<uint8_t>& is_in_lanes,
                                       ReliabilityOutput* found) {
  const auto n = static_cast<Eigen::Index>(system_.num_unknowns());
  const auto count = static_cast<Eigen::Index>(effects.size());
  const Eigen::Index degrees =
      constraints_ == nullptr || is_in_lanes.empty() ? 0 : gauge_->degrees();
  const auto width = static_cast<int>((count + degrees + 3) / 4);
  Matrix by_unknown = Matrix::Zero(n, 4 * width);
  if (degrees > 0) {
    Matrix rows_n(n, degrees), rows_y(n, degrees);
    constraints_->RowsOfUnknowns(0, static_cast<int>(n), rows_n.data(), rows_y.data());
    by_unknown.middleCols(count, degrees) = rows_y;
  }
  struct Largest {
    double square = 0;
    int point = -1;
  };
  std::vector<Largest> known;
  std::vector<int> own_point;
  for (Eigen::Index k = 0; k < count; ++k) {
    const ExternalEffect& effect = found->worst[effects[k]];
    by_unknown.col(k) = x.col(effects[k]);
    known.push_back({effect.point_sigmas * effect.point_sigmas, effect.point});
    own_point.push_back(view().observation_point[effect.observation]);
  }
  std::vector<std::vector<Largest>> largest(system_.num_threads(), known);
  std::vector<std::vector<double>> room(system_.num_threads(),
                                        std::vector<double>(4 * size_t(width)));
  using Columns = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor, 3, Kernels::kMostMoved>;
  // `moved`: -Y_p^T of all columns.
  const auto judge = [&](int p, Columns moved, const Matrix3& covariance, int thread) {
    for (Eigen::Index k = 0; k < count; ++k) {
      if (own_point[k] == p) moved.col(k) += own.col(effects[k]);
    }
    const Matrix3 information = covariance.inverse();
    double* const squares = room[thread].data();
    FindSquares(information.data(), moved.data(), width, squares);
    for (Eigen::Index k = 0; k < count; ++k) {
      Largest& of = largest[thread][k];
      if (squares[k] > of.square || (squares[k] == of.square && p < of.point)) of = {squares[k], p};
    }
  };
  const auto judge_in_lanes = [&](int p, const double* inverse, const double* rows, int thread) {
    const Columns moved = -Eigen::Map<const Columns>(rows, 3, 4 * width);
    Matrix3 covariance = Eigen::Map<const Matrix3>(&output_.points[9 * size_t(p)]);
    if (degrees > 0) {
      const Columns of_n = gauge_->OfPoint(p);
      const Columns of_y =
          Eigen::Map<const Matrix3>(inverse).lazyProduct(of_n) + moved.middleCols(count, degrees);
      constraints_->Transform(3, of_n.data(), of_y.data(), 3, of_n.data(), of_y.data(),
                              covariance.data());
    }
    judge(p, moved, covariance, thread);
  };
  if (!is_in_lanes.empty()) {
    system_.FindMovements(by_unknown.data(), width, is_in_lanes, judge_in_lanes);
  }
  std::vector<int> eliminated;
  for (const int p : by_rows) {
    if (const int kept = layout().kept_block(p); kept >= 0) {
      judge(p, by_unknown.middleRows<3>(layout().blocks()[kept].offset), OfKeptPoint(p), 0);
    } else {
      eliminated.push_back(p);
    }
  }
  std::vector<PaddedRows> padded(system_.num_threads());
  system_.ForPoints(system_.num_threads(), eliminated,
                    [&](int p, const PointBlocks& blocks, const PointAssembler&, int thread) {
                      if (blocks.num_null > 0) return;
                      Columns moved = Columns::Zero(3, 4 * width);
                      for (size_t b = 0; b < blocks.blocks.size(); ++b) {
                        const CameraBlock& block = layout().blocks()[blocks.blocks[b]];
                        using Rows = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;
                        moved -= Eigen::Map<const Rows>(&blocks.y[3 * size_t(blocks.begin[b])],
                                                        block.size, 3)
                                     .transpose()
                                     .lazyProduct(by_unknown.middleRows(block.offset, block.size));
                      }
                      judge(p, moved, OfPoint(p, blocks, &padded[thread]), thread);
                    });
  for (Eigen::Index k = 0; k < count; ++k) {
    Largest most;
    for (const std::vector<Largest>& of_thread : largest) {
      const Largest& one = of_thread[k];
      const bool is_before = one.square == most.square && one.point >= 0 && one.point < most.point;
      if (one.square > most.square || is_before) most = one;
    }
    ExternalEffect& effect = found->worst[effects[k]];
    effect.point = most.point;
    effect.point_sigmas = std::sqrt(most.square);
  }
}

/// Free points in the images of the worst observations, ascending.
std::vector<int> CovarianceComputation::PointsBeside(const ReliabilityOutput& found) const {
  std::vector<uint8_t> is_beside(view().num_images), is_wanted(view().num_points);
  for (const ExternalEffect& effect : found.worst) {
    is_beside[view().observation_image[effect.observation]] = 1;
  }
  for (int64_t i = 0; i < view().num_observations; ++i) {
    if (is_beside[view().observation_image[i]] != 0) is_wanted[view().observation_point[i]] = 1;
  }
  std::vector<int> points;
  for (int p = 0; p < view().num_points; ++p) {
    if (is_wanted[p] != 0 && layout().free().point[p] != 0) points.push_back(p);
  }
  return points;
}

/// Subtracts Y b of a point from column k.
void CovarianceComputation::SubtractEliminated(const PointBlocks& blocks, const Vector3& b,
                                               Eigen::MatrixXd* columns, int k) const {
  for (size_t a = 0; a < blocks.blocks.size(); ++a) {
    const int offset = layout().blocks()[blocks.blocks[a]].offset;
    for (int row = blocks.begin[a]; row < blocks.begin[a + 1]; ++row) {
      const Eigen::Map<const Vector3> y(&blocks.y[3 * size_t(row)]);
      (*columns)(offset + row - blocks.begin[a], k) -= y.dot(b);
    }
  }
}

}  // namespace bundle
