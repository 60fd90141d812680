#include "core/covariance/reliability.h"

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "core/covariance/covariance_computation.h"
#include "core/covariance/leverages.h"
#include "core/dense/decompositions.h"

namespace bundle {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

/// Eigenvalues below this share of the largest one are rounding errors.
constexpr double kNoVariance = 1e-12;

/// The least eigenvalue of I - h, and its direction.
struct Weakest {
  double redundancy;
  double direction[2];
};

Weakest FindWeakest(double h00, double h01, double h11) {
  const double half = 0.5 * (h00 - h11), root = std::hypot(half, h01);
  // Of the two forms of the eigenvector, the one without cancellation.
  double x = half + root, y = h01;
  if (half < 0) {
    x = h01;
    y = root - half;
  }
  const double norm = std::hypot(x, y);
  Weakest found{1 - 0.5 * (h00 + h11) - root, {1, 0}};
  if (norm > 0) {
    found.direction[0] = x / norm;
    found.direction[1] = y / norm;
  }
  return found;
}

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

/// to -= Y^T x for `size` rows of Y and of x, which are `width` registers wide, as is each of three
/// rows of `to`.
BUNDLE_FOR_TWO_PROCESSORS
void SubtractTransposed(const double* y, int size, const double* x, int width, double* to) {
  const Four* const rows = reinterpret_cast<const Four*>(x);
  Four* const sums = reinterpret_cast<Four*>(to);
  for (int w = 0; w < width; ++w) {
    Four sum[3] = {sums[w], sums[width + w], sums[2 * width + w]};
    for (int r = 0; r < size; ++r) {
      for (int c = 0; c < 3; ++c) sum[c] -= y[3 * r + c] * rows[width * r + w];
    }
    for (int c = 0; c < 3; ++c) sums[width * c + w] = sum[c];
  }
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

void CovarianceComputation::FindReliability(const ReliabilityOptions& wanted,
                                            ReliabilityOutput* found) {
  if (is_small_) system_.EliminateByRows();
  HoldGauge();
  CountResiduals();
  BlockValues held = wanted.num_worst > 0 ? system_.values() : BlockValues();
  Factorize();
  FindDirections();
  const LongMatrix inverse = LongInverse();
  InvertAndCheck();
  FindLeverages(inverse, wanted, found);
  if (wanted.num_worst > 0) {
    FindWorst(wanted, found);
    // The poses' covariances need the blocks of the inverse, the movements the factor.
    if (constraints_ != nullptr) {
      constraints_->TransformBlocks(system_.structure(), &system_.values());
    }
    FindImages();
    BlockValues blocks_of_inverse = std::move(system_.values());
    system_.SetSystem(std::move(held));
    Check(system_.Factorize());
    if (is_small_) {
      const Eigen::MatrixXd rounded = lower_.cast<double>();
      system_.TakeFactor(rounded.data());
    }
    FindEffects(std::move(blocks_of_inverse), found);
  }
  for (const NullPoint& null : system_.null_points()) output_.null_points.push_back(null.point);
  output_.warnings = system_.warnings();
  found->sums = std::move(output_);
}

void CovarianceComputation::FindLeverages(const LongMatrix& inverse,
                                          const ReliabilityOptions& wanted,
                                          ReliabilityOutput* found) {
  const auto n = static_cast<size_t>(view().num_observations);
  found->residuals.assign(2 * n, kUnknown);
  found->leverages.assign(3 * n, kUnknown);
  found->weights.assign(n, kUnknown);
  std::map<int, Eigen::MatrixXd> of_points;  // with factors of their own
  system_.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    if (!rows.points.empty()) of_points.emplace(rows.points[0], Matrix3::Zero());
  });
  LeverageOptions options;
  for (const auto& [point, covariance] : of_points) options.points.push_back(point);
  ForLeverages(
      system_, inverse,
      [&](const Leverage& of) {
        const auto i = static_cast<size_t>(of.observation);
        std::copy_n(of.residual, 2, &found->residuals[2 * i]);
        found->weights[i] = of.weight;
        found->leverages[3 * i] = of.h(0, 0);
        found->leverages[3 * i + 1] = 0.5 * (of.h(0, 1) + of.h(1, 0));
        found->leverages[3 * i + 2] = of.h(1, 1);
      },
      [&](int point, const PointBlocks&, const PointAssembler&, const PointLeverages& leverages) {
        const auto at = of_points.find(point);
        if (at != of_points.end()) at->second = leverages.Covariance();
      },
      options);
  const size_t m = view().factors == nullptr ? 0 : view().factors->factors.size();
  found->factor_measurements.assign(m, 0);
  found->factor_redundancy.assign(m, kUnknown);
  found->factor_least.assign(m, kUnknown);
  found->factor_test.assign(m, kUnknown);
  found->factor_rank.assign(m, 0);
  system_.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    const auto k = static_cast<size_t>(rows.factor);
    const Eigen::MatrixXd j =
        Eigen::Map<const Matrix>(rows.jacobian.data(), rows.num_rows,
                                 static_cast<Eigen::Index>(rows.jacobian.size()) / rows.num_rows);
    Eigen::MatrixXd h = Eigen::MatrixXd::Zero(rows.num_rows, rows.num_rows);
    if (!rows.points.empty()) {
      h = Multiply(Multiply(j, of_points.at(rows.points[0])), j.transpose());
    } else if (!rows.unknowns.empty()) {
      h = Multiply(Multiply(j, CovarianceOf(rows.unknowns, inverse)), j.transpose());
    }
    const SymmetricEigen of = DecomposeSymmetric(0.5 * (h + h.transpose()));
    const Eigen::VectorXd along = MultiplyTransposed(
        of.vectors, Eigen::Map<const Eigen::VectorXd>(rows.residual.data(), rows.num_rows));
    const int idle = rows.num_rows - rows.num_measurements;  // rows that follow from the others
    found->factor_measurements[k] = rows.num_measurements;
    found->factor_redundancy[k] = rows.num_measurements - h.trace();
    found->factor_least[k] = 1 - of.values[rows.num_rows - 1];
    found->factor_test[k] = 0;
    for (Eigen::Index i = idle; i < rows.num_rows; ++i) {
      const double redundancy = 1 - of.values[i];
      if (redundancy < wanted.least) continue;
      found->factor_test[k] += along[i] * along[i] / redundancy;
      ++found->factor_rank[k];
    }
  });
}

/// Entries of C between all pairs of these unknowns, whose blocks a factor couples.
Eigen::MatrixXd CovarianceComputation::CovarianceOf(const std::vector<int>& unknowns,
                                                    const LongMatrix& inverse) const {
  const auto size = static_cast<Eigen::Index>(unknowns.size());
  const BlockStructure& s = system_.structure();
  Eigen::MatrixXd covariance(size, size);
  for (Eigen::Index a = 0; a < size; ++a) {
    for (Eigen::Index b = 0; b < size; ++b) {
      if (inverse.size() > 0) {
        covariance(a, b) = static_cast<double>(inverse(unknowns[a], unknowns[b]));
        continue;
      }
      const int row = std::max(unknowns[a], unknowns[b]);
      const int column = std::min(unknowns[a], unknowns[b]);
      const int i = s.BlockOf(row), j = s.BlockOf(column);
      covariance(a, b) =
          system_.values()[s.ValueIndex(j, s.Entry(j, i), row - s.offset[i], column - s.offset[j])];
    }
  }
  return covariance;
}

/// The observations of the least redundancy that is not below the limit; ties by index.
void CovarianceComputation::FindWorst(const ReliabilityOptions& wanted,
                                      ReliabilityOutput* found) const {
  std::vector<std::pair<double, int64_t>> candidates;
  for (int64_t i = 0; i < view().num_observations; ++i) {
    const double* const h = &found->leverages[3 * size_t(i)];
    if (!(found->weights[i] > 0)) continue;
    const double least = FindWeakest(h[0], h[1], h[2]).redundancy;
    if (least >= wanted.least) candidates.emplace_back(least, i);
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
/// Inner constraints subtract N s, with s = N^T x = K^T x_c + N_q^T V_q^-1 b_q (free_gauge.h).
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
    const double* const h = &found->leverages[3 * size_t(i)];
    const Weakest weakest = FindWeakest(h[0], h[1], h[2]);
    const double length = 1 / std::sqrt(weakest.redundancy);
    const double u[2] = {length * weakest.direction[0], length * weakest.direction[1]};
    for (int b = 0; b < rows.num_blocks; ++b) {
      const int offset = layout().blocks()[rows.block[b]].offset;
      for (int c = 0; c < rows.size[b]; ++c) {
        rhs(offset + c, k) +=
            u[0] * rows.jacobian[b][c] + u[1] * rows.jacobian[b][rows.size[b] + c];
      }
    }
    const int point = view().observation_point[i];
    if (!layout().point_is_free(point)) continue;
    Vector3 of_point;
    for (int c = 0; c < 3; ++c) of_point[c] = u[0] * rows.point[c] + u[1] * rows.point[3 + c];
    system_.ForPoints(1, {point}, [&](int, const PointBlocks& blocks, const PointAssembler&, int) {
      SubtractEliminated(blocks, of_point, &rhs, k);
      own.col(k) = Eigen::Map<const Matrix3>(blocks.inverse) * of_point;
      if (degrees > 0) s.col(k) += gauge_->OfPoint(point).transpose().lazyProduct(own.col(k));
    });
  }
  Check(system_.Solve(rhs.data(), count, x.data()));
  if (degrees > 0) s += MultiplyTransposed(gauge_->reduced(), x);
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
  // The columns of an unknown side by side, four in a register.
  const int width = (count + 3) / 4;
  std::vector<double> by_unknown(4 * size_t(width) * n);
  for (int row = 0; row < n; ++row) {
    for (int k = 0; k < count; ++k) by_unknown[4 * size_t(width) * row + k] = x(row, k);
  }
  std::swap(system_.values(), inverse);
  const std::vector<int> points = PointsBeside(*found);
  std::vector<PaddedRows> padded(system_.num_threads());
  std::vector<std::vector<double>> room(system_.num_threads());
  std::vector<std::vector<ExternalEffect>> effects(system_.num_threads(), found->worst);
  system_.ForPoints(system_.num_threads(), points,
                    [&](int p, const PointBlocks& blocks, const PointAssembler&, int thread) {
                      if (blocks.num_null > 0) return;
                      const Matrix3 information = OfPoint(p, blocks, &padded[thread]).inverse();
                      room[thread].assign(4 * 4 * size_t(width), 0.0);
                      double* const squares = &room[thread][3 * 4 * size_t(width)];
                      using Columns = Eigen::Matrix<double, 3, Eigen::Dynamic, Eigen::RowMajor>;
                      Eigen::Map<Columns> of(room[thread].data(), 3, 4 * width);
                      for (int k = 0; k < count; ++k) {
                        if (view().observation_point[found->worst[k].observation] == p)
                          of.col(k) = own.col(k);
                      }
                      for (size_t b = 0; b < blocks.blocks.size(); ++b) {
                        const CameraBlock& block = layout().blocks()[blocks.blocks[b]];
                        SubtractTransposed(&blocks.y[3 * size_t(blocks.begin[b])], block.size,
                                           &by_unknown[4 * size_t(width) * block.offset], width,
                                           of.data());
                      }
                      if (degrees > 0) of.leftCols(count) -= gauge_->OfPoint(p).lazyProduct(s);
                      FindSquares(information.data(), of.data(), width, squares);
                      for (int k = 0; k < count; ++k) {
                        const double moved_by = std::sqrt(squares[k]);
                        ExternalEffect& effect = effects[thread][k];
                        if (!(moved_by > effect.point_sigmas)) continue;
                        effect.point = p;
                        effect.point_sigmas = moved_by;
                      }
                    });
  for (const std::vector<ExternalEffect>& of_thread : effects) {  // of ascending points
    for (int k = 0; k < count; ++k) {
      if (of_thread[k].point_sigmas > found->worst[k].point_sigmas) found->worst[k] = of_thread[k];
    }
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
    if (is_wanted[p] != 0 && layout().point_is_free(p)) points.push_back(p);
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

ReliabilityOutput ComputeReliability(const AdjustmentProblem& problem, const SolveOptions& options,
                                     const ReliabilityOptions& wanted) {
  SolveOptions all = options;
  all.gauge = Gauge::kNone;
  CovarianceOptions of_inverse;
  of_inverse.long_sums = wanted.long_sums;
  ReliabilityOutput found;
  CovarianceComputation(problem, all, of_inverse).FindReliability(wanted, &found);
  return found;
}

}  // namespace bundle
