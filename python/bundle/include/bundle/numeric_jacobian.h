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
#include <utility>
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

/// Ratio of the longest to the first step, to half of the parameter.
inline constexpr double kLonger = 8;
/// Longest step along a manifold.
inline constexpr double kLongestTurn = 0.5;

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

/// Noise of the values along each line. A value that changes in jumps of q along one line has the
/// resolution q along all lines on which it stands still at some step.
class LineNoise {
 public:
  explicit LineNoise(std::vector<double> noise)
      : noise_(std::move(noise)), jumps_(noise_.size(), std::numeric_limits<double>::infinity()) {}

  void Add(const LineFunction& f, double first_step) {
    const int n = static_cast<int>(noise_.size());
    lines_.push_back(FindResolution(f, n, first_step, noise_.data()));
    for (int i = 0; i < n; ++i) {
      const double jump = lines_.back().jump[i];
      if (jump > 0) jumps_[i] = std::min(jumps_[i], jump);
    }
  }

  std::vector<double> Of(size_t line) const {
    std::vector<double> noise = noise_;
    for (size_t i = 0; i < noise.size(); ++i) {
      noise[i] = std::max(noise[i], lines_[line].jump[i]);
      if (!lines_[line].stood_still[i] || !std::isfinite(jumps_[i])) continue;
      noise[i] = std::max(noise[i], jumps_[i]);
    }
    return noise;
  }

 private:
  const std::vector<double> noise_;
  std::vector<double> jumps_;  ///< smallest jump of each value
  std::vector<Resolution> lines_;
};

/// Writes columns into a Jacobian as they are computed.
class ColumnWriter {
 public:
  ColumnWriter(int num_rows, int num_columns, NumericJacobian* jacobian)
      : rows_(num_rows), columns_(num_columns), jacobian_(jacobian) {
    jacobian->values.resize(static_cast<size_t>(rows_) * columns_);
    jacobian->uncertainty.resize(static_cast<size_t>(rows_) * columns_);
  }

  void Add(const std::vector<double>& derivative, const std::vector<double>& uncertainty) {
    for (int row = 0; row < rows_; ++row) {
      jacobian_->values[row * columns_ + next_] = derivative[row];
      jacobian_->uncertainty[row * columns_ + next_] = uncertainty[row];
    }
    ++next_;
  }

 private:
  const int rows_, columns_;
  NumericJacobian* jacobian_;
  int next_ = 0;
};

/// Calls visit(line, first step, longest step, is ambient, is tangent) for the line along each
/// number of the blocks and, if manifolds are curved, along each tangent coordinate.
template <typename Visit>
void ForEachLine(const ceres::CostFunction& cost, const Manifolds& manifolds,
                 const std::vector<const double*>& parameters, const KnownScales& known,
                 const Visit& visit) {
  constexpr double kAny = std::numeric_limits<double>::infinity();
  MovablePoint point(cost, parameters);
  size_t column = 0;
  for (size_t b = 0; b < parameters.size(); ++b) {
    const int size = cost.parameter_block_sizes()[b];
    std::vector<double> moved(parameters[b], parameters[b] + size);
    for (int j = 0; j < size; ++j) {
      const LineFunction along_axis = [&](double step, double* residuals) {
        moved[j] = parameters[b][j] + step;
        return point.Evaluate(b, moved.data(), residuals);
      };
      const double largest = known.largest_steps.empty() ? kAny : known.largest_steps[column];
      ++column;
      const double first_step = std::min(FirstStep(parameters[b][j]), largest);
      visit(along_axis, first_step, std::min(kLonger * first_step, largest), true,
            manifolds[b] == nullptr);
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
      visit(along_manifold, kLeastFirstStep, kLongestTurn, false, true);
      entry = 0;
    }
  }
}

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
  for (size_t i = 0; i < known.minuends.size(); ++i) noise[i] += kEpsilon * known.minuends[i];
  const int n = cost.num_residuals();
  numeric_internal::LineNoise line_noise(noise);
  numeric_internal::ForEachLine(cost, manifolds, parameters, known,
                                [&](const LineFunction& f, double first_step, double, bool, bool) {
                                  line_noise.Add(f, first_step);
                                });
  numeric_internal::ColumnWriter ambient(n, AmbientSize(cost), &jacobians.ambient);
  numeric_internal::ColumnWriter tangent(n, curved ? TangentSize(cost, manifolds) : 0,
                                         &jacobians.tangent);
  std::vector<double> derivative(n), uncertainty(n);
  size_t line = 0;
  const auto differentiate = [&](const LineFunction& f, double first_step, double longest_step,
                                 bool is_ambient, bool is_tangent) {
    RichardsonDerivative(f, n, first_step, line_noise.Of(line++).data(), derivative.data(),
                         uncertainty.data(), longest_step);
    if (is_ambient) ambient.Add(derivative, uncertainty);
    if (curved && is_tangent) tangent.Add(derivative, uncertainty);
  };
  numeric_internal::ForEachLine(cost, manifolds, parameters, known, differentiate);
  if (!curved) jacobians.tangent = jacobians.ambient;
  return jacobians;
}

}  // namespace bundle
