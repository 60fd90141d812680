#include "core/ceres/gradient_check.h"

#include <ceres/gradient_checker.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <random>

#include "core/ceres/ceres_graph.h"
#include "core/checking/richardson.h"

namespace bundle {

namespace {

/// First steps are a sixteenth of the parameter, or this value for a parameter close to zero.
constexpr double kLeastFirstStep = 1.0 / 128;

double FirstStep(double parameter) { return std::max(std::abs(parameter) / 16, kLeastFirstStep); }

/// Rounding error of each residual: its change when all parameters change by a few units in their
/// last place. A residual is often the small difference of large numbers, so that its own size
/// gives no bound.
std::vector<double> RoundingNoise(const ceres::CostFunction& cost,
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
class ColumnWriter {
 public:
  ColumnWriter(const std::vector<double>& noise, int num_columns, NumericJacobian* jacobian)
      : noise_(noise),
        rows_(static_cast<int>(noise.size())),
        columns_(num_columns),
        jacobian_(jacobian) {
    jacobian->values.resize(static_cast<size_t>(rows_) * columns_);
    jacobian->uncertainty.resize(static_cast<size_t>(rows_) * columns_);
  }

  void Add(const LineFunction& f, double first_step) {
    std::vector<double> derivative(rows_), uncertainty(rows_);
    RichardsonDerivative(f, rows_, first_step, noise_.data(), derivative.data(),
                         uncertainty.data());
    for (int row = 0; row < rows_; ++row) {
      jacobian_->values[row * columns_ + next_] = derivative[row];
      jacobian_->uncertainty[row * columns_ + next_] = uncertainty[row];
    }
    ++next_;
  }

 private:
  const std::vector<double>& noise_;
  const int rows_, columns_;
  NumericJacobian* jacobian_;
  int next_ = 0;
};

/// A cost function that repeats the residual of its first evaluation at a given point.
/// GradientChecker logs every residual that differs between two calls.
class SameResidual final : public ceres::CostFunction {
 public:
  SameResidual(const ceres::CostFunction& cost, const std::vector<const double*>& point)
      : cost_(cost), point_(point) {
    set_num_residuals(cost.num_residuals());
    *mutable_parameter_block_sizes() = cost.parameter_block_sizes();
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (!cost_.Evaluate(parameters, residuals, jacobians)) return false;
    if (!IsPoint(parameters)) return true;
    if (first_.empty()) first_.assign(residuals, residuals + num_residuals());
    std::copy(first_.begin(), first_.end(), residuals);
    return true;
  }

 private:
  bool IsPoint(double const* const* parameters) const {
    for (size_t b = 0; b < point_.size(); ++b) {
      if (!std::equal(point_[b], point_[b] + parameter_block_sizes()[b], parameters[b])) {
        return false;
      }
    }
    return true;
  }

  const ceres::CostFunction& cost_;
  const std::vector<const double*>& point_;
  mutable std::vector<double> first_;
};

}  // namespace

int AmbientSize(const ceres::CostFunction& cost) {
  int size = 0;
  for (const int32_t block : cost.parameter_block_sizes()) size += block;
  return size;
}

int TangentSize(const ceres::CostFunction& cost, const Manifolds& manifolds) {
  int size = 0;
  for (size_t b = 0; b < manifolds.size(); ++b) {
    size += manifolds[b] == nullptr ? cost.parameter_block_sizes()[b] : manifolds[b]->TangentSize();
  }
  return size;
}

ReferenceJacobians DifferentiateByRichardson(const ceres::CostFunction& cost,
                                             const Manifolds& manifolds,
                                             const std::vector<const double*>& parameters,
                                             const KnownScales& known) {
  ReferenceJacobians jacobians;
  const bool curved = std::any_of(manifolds.begin(), manifolds.end(),
                                  [](const ceres::Manifold* m) { return m != nullptr; });
  std::vector<double> noise = RoundingNoise(cost, parameters, known);
  constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
  for (double& value : noise) value += kEpsilon * known.minuend;
  ColumnWriter ambient(noise, AmbientSize(cost), &jacobians.ambient);
  ColumnWriter tangent(noise, curved ? TangentSize(cost, manifolds) : 0, &jacobians.tangent);
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
      double first_step = FirstStep(parameters[b][j]);
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
      tangent.Add(along_manifold, kLeastFirstStep);
      entry = 0;
    }
  }
  if (!curved) jacobians.tangent = jacobians.ambient;
  return jacobians;
}

GradientCheckerProbe RunGradientChecker(const ceres::CostFunction& cost, const Manifolds& manifolds,
                                        const std::vector<const double*>& parameters,
                                        double relative_precision) {
  const SameResidual repeatable(cost, parameters);
  // For the manifolds, a plain nullptr would be ambiguous in Ceres 2.1.
  const ceres::GradientChecker checker(&repeatable, &manifolds, ceres::NumericDiffOptions());
  ceres::GradientChecker::ProbeResults results;
  GradientCheckerProbe probe;
  probe.agrees = checker.Probe(parameters.data(), relative_precision, &results);
  probe.message = std::move(results.error_log);
  if (!results.return_value || results.local_numeric_jacobians.size() != parameters.size()) {
    return probe;
  }
  const auto side_by_side = [&](const auto& blocks) {
    std::vector<double> values;
    for (int row = 0; row < cost.num_residuals(); ++row) {
      for (const auto& block : blocks) {
        for (int j = 0; j < block.cols(); ++j) values.push_back(block(row, j));
      }
    }
    return values;
  };
  probe.local_jacobian = side_by_side(results.local_jacobians);
  probe.local_numeric_jacobian = side_by_side(results.local_numeric_jacobians);
  return probe;
}

namespace {

class FunctionCost final : public ceres::CostFunction {
 public:
  explicit FunctionCost(const FunctionAtPoint& at) : function_(at.function) {
    set_num_residuals(at.num_residuals);
    for (const std::vector<double>& block : at.blocks) {
      mutable_parameter_block_sizes()->push_back(static_cast<int32_t>(block.size()));
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    return function_(parameters, residuals, jacobians);
  }

 private:
  const ResidualFunction& function_;
};

/// The same function as a cost function of Ceres.
struct CostAtPoint {
  explicit CostAtPoint(const FunctionAtPoint& at) : cost(at) {
    for (size_t b = 0; b < at.blocks.size(); ++b) {
      const int size = static_cast<int>(at.blocks[b].size());
      owned.push_back(MakeManifold(at.manifolds[b].name, size, at.manifolds[b].constant));
      manifolds.push_back(owned.back().get());
      parameters.push_back(at.blocks[b].data());
    }
  }

  FunctionCost cost;
  std::vector<std::unique_ptr<ceres::Manifold>> owned;
  Manifolds manifolds;
  std::vector<const double*> parameters;
};

}  // namespace

ReferenceJacobians DifferentiateByRichardson(const FunctionAtPoint& at) {
  const CostAtPoint point(at);
  return DifferentiateByRichardson(point.cost, point.manifolds, point.parameters);
}

GradientCheckerProbe RunGradientChecker(const FunctionAtPoint& at, double relative_precision) {
  const CostAtPoint point(at);
  return RunGradientChecker(point.cost, point.manifolds, point.parameters, relative_precision);
}

int ManifoldTangentSize(const ManifoldSpec& spec, int size) {
  const auto manifold = MakeManifold(spec.name, size, spec.constant);
  return manifold == nullptr ? size : manifold->TangentSize();
}

std::vector<double> ManifoldPlus(const ManifoldSpec& spec, const std::vector<double>& x,
                                 const std::vector<double>& delta) {
  std::vector<double> moved = x;
  const auto manifold = MakeManifold(spec.name, static_cast<int>(x.size()), spec.constant);
  if (manifold != nullptr) {
    manifold->Plus(x.data(), delta.data(), moved.data());
  } else {
    for (size_t j = 0; j < x.size(); ++j) moved[j] += delta[j];
  }
  return moved;
}

}  // namespace bundle
