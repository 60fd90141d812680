#include "core/covariance/point_blocks.h"

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>

#include "core/geometry/rotation.h"
#include "core/model/factor_costs.h"
#include "core/model/problem_factors.h"
#include "core/schur/kernels/kernels.h"

namespace bundle {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

/// Inverts by V = L L^T. False if V is not clearly regular.
bool InvertRegular(PointBlocks* blocks) {
  const double* const v = blocks->v;
  const double a = v[0];
  if (!(a > 0)) return false;
  const double l10 = v[3] / a, l20 = v[6] / a;
  const double d1 = v[4] - l10 * v[3];
  if (!(d1 > kClearPivot * v[4])) return false;
  const double e = v[7] - l20 * v[3], l21 = e / d1;
  const double d2 = v[8] - l20 * v[6] - l21 * e;
  if (!(d2 > kClearPivot * v[8])) return false;
  // Scaled first, because columns may have very different sizes.
  const double largest = std::max({v[0], v[4], v[8]});
  if (!(std::min({v[0], v[4], v[8]}) > kClearPivot * largest)) return false;
  const double m10 = -l10, m20 = l10 * l21 - l20, m21 = -l21;  // L^-1, a unit triangle
  const double i0 = 1 / a, i1 = 1 / d1, i2 = 1 / d2;
  double* const x = blocks->inverse;
  x[0] = i0 + m10 * i1 * m10 + m20 * i2 * m20;
  x[1] = x[3] = m10 * i1 + m20 * i2 * m21;
  x[2] = x[6] = m20 * i2;
  x[4] = i1 + m21 * i2 * m21;
  x[5] = x[7] = m21 * i2;
  x[8] = i2;
  blocks->num_null = 0;
  blocks->largest = largest;
  return true;
}

/// The pseudo-inverse of V, and its null directions.
void Invert(PointBlocks* blocks) {
  Eigen::Map<Matrix3> inverse(blocks->inverse), null(blocks->null_projector);
  null.setZero();
  if (InvertRegular(blocks)) return;
  const Eigen::SelfAdjointEigenSolver<Matrix3> solver(Eigen::Map<const Matrix3>(blocks->v));
  inverse.setZero();
  blocks->num_null = 0;
  blocks->largest = solver.eigenvalues()[2];
  for (int i = 0; i < 3; ++i) {
    const double value = solver.eigenvalues()[i];
    const Eigen::Vector3d direction = solver.eigenvectors().col(i);
    if (value > kNullPoint * blocks->largest) {
      inverse += direction * direction.transpose() / value;
    } else {
      null += direction * direction.transpose();
      ++blocks->num_null;
    }
  }
}

}  // namespace

void ShareOf(const ObservationRows& rows, int b, double* share) {
  const double* const j = rows.jacobian[b];
  for (int k = 0; k < rows.size[b]; ++k) {
    share[k] = j[k] * rows.score[0] + j[rows.size[b] + k] * rows.score[1];
  }
}

void PointShare(const ObservationRows& rows, double share[3]) {
  for (int k = 0; k < 3; ++k) {
    share[k] = rows.point[k] * rows.score[0] + rows.point[3 + k] * rows.score[1];
  }
}

PointAssembler::Tracks PointAssembler::FindTracks(const AdjustmentProblem& problem,
                                                  const ParameterLayout& layout,
                                                  const CameraStates& states) {
  Tracks tracks;
  tracks.begin.assign(static_cast<size_t>(problem.num_points) + 1, 0);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    ++tracks.begin[problem.observation_point[i] + 1];
  }
  for (int p = 0; p < problem.num_points; ++p) tracks.begin[p + 1] += tracks.begin[p];
  std::vector<int64_t> next(tracks.begin.begin(), tracks.begin.end() - 1);
  tracks.observation.resize(problem.num_observations);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    tracks.observation[next[problem.observation_point[i]]++] = i;
  }
  if (problem.factors == nullptr) return tracks;
  for (const std::unique_ptr<Factor>& factor : problem.factors->factors) {
    const ChartedFactor charted(*factor, problem, layout);
    if (charted.unknowns().points.size() != 1 || !charted.unknowns().blocks.empty()) continue;
    const int point = charted.unknowns().points.front();
    const double* const values = problem.points + 3 * int64_t{point};
    std::vector<double> residual(charted.num_residuals());
    std::vector<double> jacobian(3 * residual.size());
    if (!charted.Evaluate(states, &values, residual.data(), jacobian.data())) continue;
    ApplyLoss(*factor, 3, residual.data(), jacobian.data());
    tracks.prior.resize(9 * static_cast<size_t>(problem.num_points));
    tracks.prior_gradient.resize(3 * static_cast<size_t>(problem.num_points));
    double* const gradient = &tracks.prior_gradient[3 * static_cast<size_t>(point)];
    double* const prior = &tracks.prior[9 * static_cast<size_t>(point)];
    for (size_t row = 0; row < residual.size(); ++row) {
      for (int k = 0; k < 9; ++k) prior[k] += jacobian[3 * row + k / 3] * jacobian[3 * row + k % 3];
      for (int k = 0; k < 3; ++k) gradient[k] += jacobian[3 * row + k] * residual[row];
    }
  }
  return tracks;
}

PointAssembler::PointAssembler(const ParameterLayout& layout, const ObservationEvaluator& evaluator,
                               const Tracks& tracks)
    : layout_(layout), evaluator_(evaluator), tracks_(tracks), place_(layout.blocks().size(), -1) {}

void PointAssembler::Assemble(int point, PointBlocks* blocks) {
  const int64_t first = tracks_.begin[point], last = tracks_.begin[point + 1];
  if (last - first > static_cast<int64_t>(rows_.size())) rows_.resize(last - first);
  num_rows_ = 0;
  for (int64_t k = first; k < last; ++k) {
    num_rows_ += evaluator_.Evaluate(tracks_.observation[k], &rows_[num_rows_]) ? 1 : 0;
  }
  FindBlocks(blocks);
  std::fill_n(blocks->v, 9, 0.0);
  if (!tracks_.prior.empty()) std::copy_n(&tracks_.prior[9 * size_t(point)], 9, blocks->v);
  for (int r = 0; r < num_rows_; ++r) {
    const ObservationRows& rows = rows_[r];
    for (int k = 0; k < 9; ++k) {
      blocks->v[k] +=
          rows.point[k / 3] * rows.point[k % 3] + rows.point[3 + k / 3] * rows.point[3 + k % 3];
    }
    for (int b = 0; b < rows.num_blocks; ++b) {
      const double* const j = rows.jacobian[b];
      double* to = &blocks->w[3 * size_t(blocks->begin[place_[rows.block[b]]])];
      for (int i = 0; i < rows.size[b]; ++i, to += 3) {
        const double x = j[i], y = j[rows.size[b] + i];
        for (int k = 0; k < 3; ++k) to[k] += x * rows.point[k] + y * rows.point[3 + k];
      }
    }
  }
  for (const int block : blocks->blocks) place_[block] = -1;
  Invert(blocks);
  for (size_t i = 0; i < blocks->w.size(); i += 3) {
    VectorMatrix3(&blocks->w[i], blocks->inverse, &blocks->y[i]);
  }
}

void PointAssembler::FindBlocks(PointBlocks* blocks) {
  blocks->blocks.clear();
  for (int r = 0; r < num_rows_; ++r) {
    const ObservationRows& rows = rows_[r];
    for (int b = 0; b < rows.num_blocks; ++b) {
      if (place_[rows.block[b]] >= 0) continue;
      place_[rows.block[b]] = 0;
      blocks->blocks.push_back(rows.block[b]);
    }
  }
  std::sort(blocks->blocks.begin(), blocks->blocks.end());
  blocks->begin.assign(1, 0);
  for (size_t i = 0; i < blocks->blocks.size(); ++i) {
    place_[blocks->blocks[i]] = static_cast<int>(i);
    blocks->begin.push_back(blocks->begin.back() + layout_.blocks()[blocks->blocks[i]].size);
  }
  blocks->w.assign(3 * size_t(blocks->begin.back()), 0.0);
  blocks->y.resize(blocks->w.size());
}

}  // namespace bundle
