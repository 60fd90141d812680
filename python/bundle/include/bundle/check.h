#pragma once

/// Checks the Jacobians of Ceres cost functions in C++ tests. Needs Ceres 2.1 or later and C++17:
///
///   #include <bundle/check.h>
///
///   TEST(Reprojection, Jacobians) {
///     const ReprojectionCost cost(320, 240);
///     const ceres::QuaternionManifold rotation;
///     const bundle::GradientCheck check =
///         bundle::CheckGradients(cost, {q, t, point}, {&rotation, nullptr, nullptr});
///     EXPECT_TRUE(check.ok()) << check;
///   }
///
/// Jacobians are compared at the given point and at points around it, along the tangent space of
/// the manifolds, with Richardson extrapolation (bundle/numeric_jacobian.h). An entry is wrong if
/// it differs by more than the tolerance and the uncertainty of the reference, relative to the norm
/// of its column in the units of its row (bundle/entry_scales.h). A residual in single precision is
/// judged to 1e-3. These are the rules, verdicts and words of
/// bundle.check_gradients in Python, which names more mistakes (bundle/checkable.h).
///
/// Cost functions may have any sizes at run time. bundle/jet_cost.h makes one from a functor, by
/// Jets of double or float. `python -c "import bundle; print(bundle.get_include())"` prints the
/// folder to compile with.

#include <bundle/check_report.h>
#include <bundle/numeric_jacobian.h>
#include <ceres/cost_function.h>
#include <ceres/manifold.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

namespace bundle {

/// Settings of a check, with the defaults of bundle.check_gradients.
struct CheckOptions {
  int num_samples = 10;            ///< points to check, including the given one
  double radius = 0.1;             ///< distance of the others, relative to each parameter
  unsigned seed = 0;               ///< seed of the sampling
  double tolerance = 1e-7;         ///< relative error above which an entry is wrong
  std::vector<std::string> names;  ///< one per block; empty: "block 0", ...
};

namespace check_internal {

constexpr double kSingleTolerance = 1e-3;

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

[[noreturn]] inline void Refuse(const std::string& message) {
  throw std::invalid_argument(message);
}

inline void CheckArguments(const ceres::CostFunction& cost,
                           const std::vector<const double*>& parameters, const Manifolds& manifolds,
                           const CheckOptions& options) {
  const std::vector<int32_t>& sizes = cost.parameter_block_sizes();
  const auto count = [&](const char* what, size_t found) {
    if (found == sizes.size()) return;
    Refuse(std::string(what) + ": expected " + std::to_string(sizes.size()) +
           ", one per parameter block, found " + std::to_string(found));
  };
  count("parameters", parameters.size());
  count("manifolds", manifolds.size());
  if (!options.names.empty()) count("names", options.names.size());
  for (size_t b = 0; b < sizes.size(); ++b) {
    if (parameters[b] == nullptr) Refuse("parameters: block " + std::to_string(b) + " is null");
    if (manifolds[b] == nullptr || manifolds[b]->AmbientSize() == sizes[b]) continue;
    Refuse("manifolds: expected one of " + std::to_string(sizes[b]) + " parameters for block " +
           std::to_string(b) + ", found " + std::to_string(manifolds[b]->AmbientSize()));
  }
  if (cost.num_residuals() < 1) Refuse("cost function: expected at least one residual, found 0");
  if (options.num_samples < 1) {
    Refuse("num_samples: expected at least 1, found " + std::to_string(options.num_samples));
  }
  if (!(options.tolerance > 0)) Refuse("tolerance: expected a number above 0");
}

using Blocks = std::vector<std::vector<double>>;

/// A random point near x.
inline Blocks Move(const Blocks& x, const Manifolds& manifolds, double radius,
                   std::mt19937* random) {
  std::normal_distribution<double> normal;
  Blocks moved = x;
  for (size_t b = 0; b < x.size(); ++b) {
    if (manifolds[b] != nullptr) {
      std::vector<double> delta(manifolds[b]->TangentSize());
      for (double& entry : delta) entry = radius * normal(*random);
      if (!manifolds[b]->Plus(x[b].data(), delta.data(), moved[b].data())) moved[b] = x[b];
      continue;
    }
    double usual = 1;
    for (const double value : x[b]) {
      if (value != 0) usual = std::min(usual, std::abs(value));
    }
    for (double& value : moved[b]) {
      value += radius * (value != 0 ? std::abs(value) : usual) * normal(*random);
    }
  }
  return moved;
}

inline std::vector<const double*> Pointers(const Blocks& blocks) {
  std::vector<const double*> pointers;
  for (const std::vector<double>& block : blocks) pointers.push_back(block.data());
  return pointers;
}

/// The local Jacobian of all blocks, and the residuals; false without a value. Entries that
/// Evaluate does not write are not a number.
inline bool Evaluate(const ceres::CostFunction& cost, const Blocks& at, const Manifolds& manifolds,
                     std::vector<double>* residuals, std::vector<double>* local) {
  const int rows = cost.num_residuals();
  constexpr double kUnwritten = std::numeric_limits<double>::quiet_NaN();
  residuals->assign(rows, kUnwritten);
  Blocks ambient;
  std::vector<double*> pointers;
  for (const std::vector<double>& block : at) ambient.emplace_back(rows * block.size(), kUnwritten);
  for (std::vector<double>& jacobian : ambient) pointers.push_back(jacobian.data());
  if (!cost.Evaluate(Pointers(at).data(), residuals->data(), pointers.data())) return false;
  for (const double residual : *residuals) {
    if (!std::isfinite(residual)) return false;
  }
  RowMajor all(rows, TangentSize(cost, manifolds));
  int column = 0;
  for (size_t b = 0; b < at.size(); ++b) {
    const int size = static_cast<int>(at[b].size());
    const Eigen::Map<const RowMajor> given(ambient[b].data(), rows, size);
    const int moves = manifolds[b] == nullptr ? size : manifolds[b]->TangentSize();
    if (manifolds[b] == nullptr) {
      all.middleCols(column, moves) = given;
    } else {
      RowMajor plus(size, moves);
      manifolds[b]->PlusJacobian(at[b].data(), plus.data());
      all.middleCols(column, moves) = given * plus;
    }
    column += moves;
  }
  local->assign(all.data(), all.data() + all.size());
  return true;
}

/// True if all residuals were computed in single precision; 0, 1 and 0.5 tell nothing.
inline bool IsSingle(const std::vector<CheckedPoint>& points) {
  bool is_telling = false;
  for (const CheckedPoint& point : points) {
    for (const double value : point.residuals) {
      if (static_cast<double>(static_cast<float>(value)) != value) return false;
      is_telling |= std::round(value * 1024) != value * 1024;
    }
  }
  return is_telling;
}

/// Sizes of numbers in double precision whose rounding errors are those of the residuals of this
/// point in single precision, in which the parameters are rounded, too.
inline std::vector<double> SizesInSingle(const CheckedPoint& point, const Blocks& at,
                                         const Manifolds& manifolds) {
  constexpr double kRatio = static_cast<double>(std::numeric_limits<float>::epsilon()) /
                            std::numeric_limits<double>::epsilon();
  std::vector<double> parameters;  // of each column
  for (size_t b = 0; b < at.size(); ++b) {
    if (manifolds[b] == nullptr) {
      parameters.insert(parameters.end(), at[b].begin(), at[b].end());
    } else {
      const double largest =
          Eigen::Map<const Eigen::VectorXd>(at[b].data(), at[b].size()).lpNorm<Eigen::Infinity>();
      parameters.insert(parameters.end(), manifolds[b]->TangentSize(), largest);
    }
  }
  std::vector<double> sizes;
  auto entry = point.analytic.begin();
  for (const double residual : point.residuals) {
    double size = std::abs(residual);
    for (const double parameter : parameters) {
      const double moved = std::abs(*entry++ * parameter);
      if (std::isfinite(moved)) size = std::max(size, moved);
    }
    sizes.push_back(kRatio * size);
  }
  return sizes;
}

}  // namespace check_internal

/// Checks the Jacobians of a cost function.
///
/// `manifolds`: one per block, nullptr for a Euclidean block; empty: all are Euclidean. Points at
/// which Evaluate returns false are skipped. Throws std::invalid_argument, in one line, if the
/// arguments do not fit the cost function.
inline GradientCheck CheckGradients(const ceres::CostFunction& cost,
                                    const std::vector<const double*>& parameters,
                                    Manifolds manifolds = {}, const CheckOptions& options = {}) {
  if (manifolds.empty()) manifolds.resize(cost.parameter_block_sizes().size(), nullptr);
  check_internal::CheckArguments(cost, parameters, manifolds, options);
  check_internal::Blocks start;
  std::vector<CheckedBlock> blocks;
  for (size_t b = 0; b < parameters.size(); ++b) {
    const int size = cost.parameter_block_sizes()[b];
    start.emplace_back(parameters[b], parameters[b] + size);
    const bool is_curved = manifolds[b] != nullptr;
    blocks.push_back({options.names.empty() ? "block " + std::to_string(b) : options.names[b],
                      is_curved ? manifolds[b]->TangentSize() : size, is_curved});
  }
  std::mt19937 random(options.seed);
  std::vector<CheckedPoint> points;
  std::vector<check_internal::Blocks> places;
  for (int k = 0; k < options.num_samples; ++k) {
    check_internal::Blocks at =
        k == 0 ? start : check_internal::Move(start, manifolds, options.radius, &random);
    CheckedPoint point;
    point.number = k;
    if (!check_internal::Evaluate(cost, at, manifolds, &point.residuals, &point.analytic)) continue;
    points.push_back(std::move(point));
    places.push_back(std::move(at));
  }
  const int num_skipped = options.num_samples - static_cast<int>(points.size());
  const bool is_single = check_internal::IsSingle(points);
  const double tolerance =
      is_single ? std::max(options.tolerance, check_internal::kSingleTolerance) : options.tolerance;
  for (size_t k = 0; k < points.size(); ++k) {
    KnownScales known;
    if (is_single) known.minuends = check_internal::SizesInSingle(points[k], places[k], manifolds);
    NumericJacobian reference =
        DifferentiateByRichardson(cost, manifolds, check_internal::Pointers(places[k]), known)
            .tangent;
    points[k].reference = std::move(reference.values);
    points[k].uncertainty = std::move(reference.uncertainty);
  }
  return GradientCheck(std::move(blocks), std::move(points), cost.num_residuals(), tolerance,
                       num_skipped);
}

}  // namespace bundle
