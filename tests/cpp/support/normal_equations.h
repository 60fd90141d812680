#pragma once

/// The normal equations of a bundle adjustment problem as least_squares.h writes them, in extended
/// precision, out of EvaluateReprojection (factors/reprojection.h) one observation at a time.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "core/factors/reprojection.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/model/problem_factors.h"
#include "support/cost.h"
#include "support/dense_oracle.h"

namespace bundle::testing {

using oracle::Real;
using oracle::RealMatrix;
using oracle::RealVector;

/// One row of J, corrected for the loss, and its residual.
struct SparseRow {
  std::vector<int> columns;
  std::vector<Real> values;
  Real residual = 0;

  Real Times(const RealVector& x) const {
    Real sum = 0;
    for (size_t k = 0; k < columns.size(); ++k) sum += values[k] * x[columns[k]];
    return sum;
  }
};

/// rho'(s) of each loss with scale a.
inline Real LossSlope(LossType loss, Real a, Real s) {
  const Real b = a * a;
  switch (loss) {
    case LossType::kTrivial:
      return 1;
    case LossType::kHuber:
      return s <= b ? 1 : a / std::sqrt(s);
    case LossType::kSoftL1:
      return 1 / std::sqrt(1 + s / b);
    case LossType::kCauchy:
      return 1 / (1 + s / b);
    case LossType::kArctan:
      return 1 / (1 + s * s / (b * b));
    case LossType::kTukey:
      return s <= b ? (1 - s / b) * (1 - s / b) : 0;
  }
  return 1;
}

/// J and r at one state. Columns: the camera parameters as in the layout, then the free points in
/// the order of the problem.
class LinearizedProblem {
 public:
  LinearizedProblem(const AdjustmentProblem& problem, const ParameterLayout& layout,
                    const SolveOptions& options, const CameraStates& cameras,
                    const LargeVector<double>& points)
      : num_camera_columns(layout.state_size()), point_column_(problem.num_points, -1) {
    num_columns = num_camera_columns;
    for (int p = 0; p < problem.num_points; ++p) {
      if (!layout.point_is_free(p)) continue;
      point_column_[p] = num_columns;
      num_columns += 3;
    }
    for (int64_t i = 0; i < problem.num_observations; ++i) {
      AddObservation(problem, layout, options, cameras, points, i);
    }
    if (problem.factors != nullptr) {
      for (const auto& factor : problem.factors->factors) {
        AddFactor(ChartedFactor(*factor, problem, layout), layout, cameras, points);
      }
    }
    gradient = RealVector::Zero(num_columns);
    squared_norms = RealVector::Zero(num_columns);
    for (const SparseRow& row : rows) {
      for (size_t k = 0; k < row.columns.size(); ++k) {
        gradient[row.columns[k]] += row.values[k] * row.residual;
        squared_norms[row.columns[k]] += row.values[k] * row.values[k];
      }
    }
  }

  int num_camera_columns, num_columns;
  std::vector<SparseRow> rows;
  int64_t num_active = 0;  ///< observations with something to refine
  Real cost = 0;           ///< cost of these observations
  Real fixed_cost = 0;     ///< cost of the other observations
  RealVector gradient;     ///< J^T r
  RealVector squared_norms;

  RealVector JacobianTimes(const RealVector& x) const {
    RealVector product(rows.size());
    for (size_t i = 0; i < rows.size(); ++i)
      product[static_cast<Eigen::Index>(i)] = rows[i].Times(x);
    return product;
  }

 private:
  /// By the factor's own Jacobian (problem_factors_test.cpp has differences).
  void AddFactor(const ChartedFactor& charted, const ParameterLayout& layout,
                 const CameraStates& cameras, const LargeVector<double>& points) {
    const Factor& factor = charted.factor();
    const int size = charted.num_residuals();
    std::vector<double> residual(size), jacobian(size * charted.num_columns() + 1);
    std::vector<const double*> at;
    std::vector<int> columns;
    for (const int point : charted.unknowns().points) {
      at.push_back(&points[3 * static_cast<size_t>(point)]);
      for (int k = 0; k < 3; ++k) columns.push_back(point_column_[point] + k);
    }
    for (const int index : charted.unknowns().blocks) {
      const CameraBlock& block = layout.blocks()[index];
      for (int k = 0; k < block.size; ++k) columns.push_back(block.offset + k);
    }
    charted.Evaluate(cameras, at.data(), residual.data(), jacobian.data());
    Real s = 0;
    for (const double r : residual) s += Real(r) * r;
    const Real cost_here = Rho(factor.loss(), factor.loss_scale(), s) / 2;
    if (columns.empty()) {
      fixed_cost += cost_here;
      return;
    }
    cost += cost_here;
    const Real weight = std::sqrt(LossSlope(factor.loss(), factor.loss_scale(), s));
    for (int r = 0; r < size; ++r) {
      SparseRow row;
      row.residual = weight * residual[r];
      for (size_t k = 0; k < columns.size(); ++k) {
        row.columns.push_back(columns[k]);
        row.values.push_back(weight * jacobian[r * columns.size() + k]);
      }
      rows.push_back(row);
    }
  }

  /// A row by an image's own pose, or by its frame's or sensor's (rig_pose_test.cpp has
  /// differences).
  static Real ByPose(const RigPose& rig, bool is_sensor, const double* row, int column) {
    if (rig.frame == nullptr) return row[column];
    double map[36];
    is_sensor ? SensorMap(rig, map) : FrameMap(rig, map);
    Real sum = 0;
    for (int i = 0; i < 6; ++i) sum += Real(row[i]) * map[6 * i + column];
    return sum;
  }

  void AddObservation(const AdjustmentProblem& problem, const ParameterLayout& layout,
                      const SolveOptions& options, const CameraStates& cameras,
                      const LargeVector<double>& points, int64_t i) {
    const int image = problem.observation_image[i], point = problem.observation_point[i];
    const int camera = problem.image_camera[image];
    const CameraModel& model = *problem.camera_models[camera];
    ReprojectionJacobian jacobian;
    double residual[2];
    EvaluateReprojection(model, cameras.pose(image), cameras.params(camera),
                         &points[3 * static_cast<size_t>(point)], problem.observation_xy + 2 * i,
                         options.cheirality, residual, &jacobian);
    const Real x = residual[0], y = residual[1], s = x * x + y * y;
    const Real cost_here = Rho(options.loss, options.loss_scale, s) / 2;
    const Real weight = std::sqrt(LossSlope(options.loss, options.loss_scale, s));
    SparseRow pair[2];
    for (int r = 0; r < 2; ++r) {
      pair[r].residual = weight * residual[r];
      const auto add = [&](int column, Real value) {
        pair[r].columns.push_back(column);
        pair[r].values.push_back(weight * value);
      };
      for (const int index : layout.blocks_of(image)) {
        if (index < 0) continue;
        const CameraBlock& block = layout.blocks()[index];
        const bool is_sensor = index == layout.blocks_of(image)[ParameterLayout::kSensorBlock];
        for (int k = 0; k < block.size; ++k) {
          const int column = block.columns[k];
          add(block.offset + k,
              column < kPoseSize
                  ? ByPose(cameras.rig(image), is_sensor, &jacobian.pose[6 * r], column)
                  : jacobian.params[model.num_params * r + column - kPoseSize]);
        }
      }
      for (int k = 0; k < 3 && point_column_[point] >= 0; ++k) {
        add(point_column_[point] + k, jacobian.point[3 * r + k]);
      }
    }
    if (pair[0].columns.empty()) {
      fixed_cost += cost_here;
      return;
    }
    ++num_active;
    cost += cost_here;
    rows.insert(rows.end(), pair, pair + 2);
  }

  std::vector<int> point_column_;
};

/// D^2 of least_squares.h, for the scaling of the first linearisation.
class Damping {
 public:
  explicit Damping(const LinearizedProblem& first) : squared_scale_(first.squared_norms.size()) {
    for (Eigen::Index j = 0; j < squared_scale_.size(); ++j) {
      squared_scale_[j] = std::pow(1 + std::sqrt(first.squared_norms[j]), -2);
    }
  }

  RealVector SquaredD(const LinearizedProblem& now) const {
    RealVector d(squared_scale_.size());
    for (Eigen::Index j = 0; j < d.size(); ++j) {
      d[j] = std::clamp<Real>(squared_scale_[j] * now.squared_norms[j], 1e-6L, 1e32L) /
             squared_scale_[j];
    }
    return d;
  }

  const RealVector& squared_scale() const { return squared_scale_; }

 private:
  RealVector squared_scale_;
};

/// (J^T J + damping D^2) q = -J^T r with the points eliminated.
class EliminatedEquations {
 public:
  EliminatedEquations(const LinearizedProblem& problem, const RealVector& d_squared, Real damping)
      : problem_(problem) {
    const int n = problem.num_camera_columns, num_points = (problem.num_columns - n) / 3;
    camera = RealMatrix::Zero(n, n);
    w_.assign(num_points, RealMatrix::Zero(n, 3));
    v_.assign(num_points, RealMatrix::Zero(3, 3));
    for (const SparseRow& row : problem.rows) {
      for (size_t a = 0; a < row.columns.size(); ++a) {
        for (size_t b = 0; b < row.columns.size(); ++b) {
          const int i = row.columns[a], j = row.columns[b];
          const Real product = row.values[a] * row.values[b];
          if (i < n && j < n) camera(i, j) += product;
          if (i < n && j >= n) w_[(j - n) / 3](i, (j - n) % 3) += product;
          if (i >= n && j >= n) v_[(i - n) / 3]((i - n) % 3, (j - n) % 3) += product;
        }
      }
    }
    for (int j = 0; j < n; ++j) camera(j, j) += damping * d_squared[j];
    reduced = camera;
    rhs = -problem.gradient.head(n);
    for (int p = 0; p < num_points; ++p) {
      for (int k = 0; k < 3; ++k) v_[p](k, k) += damping * d_squared[n + 3 * p + k];
      if (n == 0) continue;
      const RealMatrix v_inverse_w = oracle::SolveSymmetric(v_[p], w_[p].transpose());
      reduced -= oracle::Product(w_[p], v_inverse_w);
      rhs += v_inverse_w.transpose() * problem.gradient.segment(n + 3 * p, 3);
    }
  }

  /// The Newton direction, all columns.
  RealVector Solve() const {
    const int n = problem_.num_camera_columns;
    RealVector q(problem_.num_columns);
    if (n > 0) q.head(n) = oracle::SolveSymmetric(reduced, rhs);
    for (size_t p = 0; p < v_.size(); ++p) {
      const Eigen::Index at = n + 3 * static_cast<Eigen::Index>(p);
      RealVector right = -problem_.gradient.segment(at, 3);
      if (n > 0) right -= w_[p].transpose() * q.head(n);
      q.segment(at, 3) = oracle::SolveSymmetric(v_[p], right);
    }
    return q;
  }

  RealMatrix camera;   ///< J_c^T J_c + damping D^2
  RealMatrix reduced;  ///< S
  RealVector rhs;      ///< b

 private:
  const LinearizedProblem& problem_;
  std::vector<RealMatrix> w_, v_;
};

}  // namespace bundle::testing
