#pragma once

/// Numerical Jacobians of Ceres cost functions by Richardson extrapolation (bundle/richardson.h),
/// with a bound on the error of each entry.
///
/// The differences are in the ambient space, parameter by parameter, and along the manifolds' Plus,
/// without their PlusJacobian.

#include <bundle/check_types.h>
#include <bundle/richardson.h>
#include <ceres/cost_function.h>
#include <ceres/manifold.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <vector>

namespace bundle {

/// Manifolds of a cost function's blocks, one per block; nullptr: Euclidean.
using Manifolds = std::vector<const ceres::Manifold*>;

/// Raises the noise of each value to that of its sixth differences at multiples of `step`. For a
/// smooth f, these contain only its rounding errors, each of which enters with a variance of 924 =
/// sum_k binomial(6, k)^2 (J. J. More, S. M. Wild: Estimating computational noise, SIAM J. Sci.
/// Comput. 33, 2011). The step is far above the resolution of the parameters and far below their
/// scale.
inline void RaiseToScatter(const LineFunction& f, int num_values, double step, double* noise) {
  constexpr int kOrder = 6, kDifferences = 10;
  constexpr double kVariance = 924, kLargest = 3;  // of a few errors, in standard deviations
  constexpr int kValues = kOrder + kDifferences;
  std::vector<double> values(static_cast<size_t>(kValues) * num_values);
  for (int k = 0; k < kValues; ++k) {
    if (!f((k - kValues / 2) * step, &values[k * num_values])) return;
  }
  for (int order = 1; order <= kOrder; ++order) {
    for (int k = 0; k < (kValues - order) * num_values; ++k) {
      values[k] = values[k + num_values] - values[k];
    }
  }
  for (int i = 0; i < num_values; ++i) {
    double sum = 0;
    for (int k = 0; k < kDifferences; ++k) {
      sum += values[k * num_values + i] * values[k * num_values + i];
    }
    const double scatter = kLargest * std::sqrt(sum / (kDifferences * kVariance));
    if (std::isfinite(scatter)) noise[i] = std::max(noise[i], scatter);
  }
}

namespace numeric_internal {

/// First steps are a sixteenth of the parameter, or this value for a parameter close to zero.
inline constexpr double kLeastFirstStep = 1.0 / 128;

inline double FirstStep(double parameter) {
  return std::max(std::abs(parameter) / 16, kLeastFirstStep);
}

/// Rounding error of each residual: its change when all parameters change by a few units in their
/// last place. A residual is often the small difference of large numbers, so that its own size
/// gives no bound.
inline std::vector<double> RoundingNoise(const ceres::CostFunction& cost,
                                         const std::vector<const double*>& parameters,
                                         const KnownScales& known) {
  // If the last digit of a residual is coarse, only some of these changes have an effect.
  constexpr int kTrials = 16;
  constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
  const int n = cost.num_residuals();
  std::vector<double> at_start(n), values(n), noise(n);
  if (!cost.Evaluate(parameters.data(), at_start.data(), nullptr)) return noise;
  std::vector<std::vector<double>> moved;
  for (size_t b = 0; b < parameters.size(); ++b) {
    moved.emplace_back(parameters[b], parameters[b] + cost.parameter_block_sizes()[b]);
  }
  std::vector<const double*> pointers;
  for (const std::vector<double>& block : moved) pointers.push_back(block.data());
  std::minstd_rand random(1);
  for (int trial = 0; trial < kTrials; ++trial) {
    for (size_t b = 0; b < moved.size(); ++b) {
      for (size_t j = 0; j < moved[b].size(); ++j) {
        const int units = static_cast<int>(random() % 9) - 4;
        moved[b][j] = parameters[b][j] * (1 + units * kEpsilon);
      }
    }
    if (!cost.Evaluate(pointers.data(), values.data(), nullptr)) continue;
    for (int i = 0; i < n; ++i) noise[i] = std::max(noise[i], std::abs(values[i] - at_start[i]));
  }
  for (int i = 0; i < n; ++i) noise[i] += kEpsilon * std::abs(at_start[i]);
  if (!known.largest_steps.empty()) return noise;  // a short step may already be too long
  // A parameter that is zero has no last digit to change, but the number to which it is added has
  // one.
  constexpr double kShortStep = 1e-9;
  std::vector<std::vector<double>> directions = moved;
  for (size_t b = 0; b < moved.size(); ++b) {
    for (size_t j = 0; j < moved[b].size(); ++j) {
      const double share = (2 * static_cast<int>(random() % 8) - 7) / 7.0;
      directions[b][j] = share * FirstStep(parameters[b][j]);
    }
  }
  const LineFunction along = [&](double step, double* at_step) {
    for (size_t b = 0; b < moved.size(); ++b) {
      for (size_t j = 0; j < moved[b].size(); ++j) {
        moved[b][j] = parameters[b][j] + step * directions[b][j];
      }
    }
    return cost.Evaluate(pointers.data(), at_step, nullptr);
  };
  RaiseToScatter(along, n, kShortStep, noise.data());
  return noise;
}

/// A copy of the parameter blocks, in which one block can be moved.
class MovablePoint {
 public:
  MovablePoint(const ceres::CostFunction& cost, const std::vector<const double*>& parameters)
      : cost_(cost), pointers_(parameters), parameters_(parameters) {}

  /// Evaluates with block b replaced.
  bool Evaluate(size_t b, const double* block, double* residuals) {
    pointers_[b] = block;
    const bool valid = cost_.Evaluate(pointers_.data(), residuals, nullptr);
    pointers_[b] = parameters_[b];
    return valid;
  }

 private:
  const ceres::CostFunction& cost_;
  std::vector<const double*> pointers_;
  const std::vector<const double*>& parameters_;
};

/// Writes columns into a Jacobian as they are computed.
///
/// A value that stands still along one column, and changes in jumps of q along others, may have a
/// slope in this column, too. Over a step of h it is at most q / h.
class ColumnWriter {
 public:
  ColumnWriter(const std::vector<double>& noise, int num_columns, NumericJacobian* jacobian)
      : noise_(noise),
        rows_(static_cast<int>(noise.size())),
        columns_(num_columns),
        jacobian_(jacobian),
        jumps_(noise.size(), std::numeric_limits<double>::infinity()) {
    jacobian->values.resize(static_cast<size_t>(rows_) * columns_);
    jacobian->uncertainty.resize(static_cast<size_t>(rows_) * columns_);
  }

  void Add(const LineFunction& f, double first_step) {
    std::vector<double> derivative(rows_), uncertainty(rows_);
    const Resolution resolution = RichardsonDerivative(f, rows_, first_step, noise_.data(),
                                                       derivative.data(), uncertainty.data());
    for (int row = 0; row < rows_; ++row) {
      if (resolution.jump[row] > 0) jumps_[row] = std::min(jumps_[row], resolution.jump[row]);
      if (resolution.stood_still[row]) still_.push_back({row, next_, first_step});
      jacobian_->values[row * columns_ + next_] = derivative[row];
      jacobian_->uncertainty[row * columns_ + next_] = uncertainty[row];
    }
    ++next_;
  }

  /// Raises the uncertainty of values that stood still. To be called after the last column.
  void Finish() {
    for (const Still& still : still_) {
      if (!std::isfinite(jumps_[still.row])) continue;
      double& uncertainty = jacobian_->uncertainty[still.row * columns_ + still.column];
      uncertainty = std::max(uncertainty, jumps_[still.row] / still.step);
    }
  }

 private:
  struct Still {
    int row, column;
    double step;
  };

  const std::vector<double>& noise_;
  const int rows_, columns_;
  NumericJacobian* jacobian_;
  std::vector<double> jumps_;  ///< smallest jump of each row
  std::vector<Still> still_;
  int next_ = 0;
};

}  // namespace numeric_internal

inline int AmbientSize(const ceres::CostFunction& cost) {
  int size = 0;
  for (const int32_t block : cost.parameter_block_sizes()) size += block;
  return size;
}

inline int TangentSize(const ceres::CostFunction& cost, const Manifolds& manifolds) {
  int size = 0;
  for (size_t b = 0; b < manifolds.size(); ++b) {
    size += manifolds[b] == nullptr ? cost.parameter_block_sizes()[b] : manifolds[b]->TangentSize();
  }
  return size;
}

inline ReferenceJacobians DifferentiateByRichardson(const ceres::CostFunction& cost,
                                                    const Manifolds& manifolds,
                                                    const std::vector<const double*>& parameters,
                                                    const KnownScales& known = {}) {
  ReferenceJacobians jacobians;
  const bool curved = std::any_of(manifolds.begin(), manifolds.end(),
                                  [](const ceres::Manifold* m) { return m != nullptr; });
  std::vector<double> noise = numeric_internal::RoundingNoise(cost, parameters, known);
  constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
  for (double& value : noise) value += kEpsilon * known.minuend;
  numeric_internal::ColumnWriter ambient(noise, AmbientSize(cost), &jacobians.ambient);
  numeric_internal::ColumnWriter tangent(noise, curved ? TangentSize(cost, manifolds) : 0,
                                         &jacobians.tangent);
  numeric_internal::MovablePoint point(cost, parameters);
  size_t column = 0;
  for (size_t b = 0; b < parameters.size(); ++b) {
    const int size = cost.parameter_block_sizes()[b];
    std::vector<double> moved(parameters[b], parameters[b] + size);
    for (int j = 0; j < size; ++j) {
      const LineFunction along_axis = [&](double step, double* residuals) {
        moved[j] = parameters[b][j] + step;
        return point.Evaluate(b, moved.data(), residuals);
      };
      double first_step = numeric_internal::FirstStep(parameters[b][j]);
      if (!known.largest_steps.empty()) {
        first_step = std::min(first_step, known.largest_steps[column]);
      }
      ++column;
      ambient.Add(along_axis, first_step);
      if (curved && manifolds[b] == nullptr) tangent.Add(along_axis, first_step);
      moved[j] = parameters[b][j];
    }
    if (manifolds[b] == nullptr) continue;
    std::vector<double> delta(manifolds[b]->TangentSize());
    for (double& entry : delta) {
      const LineFunction along_manifold = [&](double step, double* residuals) {
        entry = step;
        return manifolds[b]->Plus(parameters[b], delta.data(), moved.data()) &&
               point.Evaluate(b, moved.data(), residuals);
      };
      tangent.Add(along_manifold, numeric_internal::kLeastFirstStep);
      entry = 0;
    }
  }
  ambient.Finish();
  tangent.Finish();
  if (!curved) jacobians.tangent = jacobians.ambient;
  return jacobians;
}

}  // namespace bundle
