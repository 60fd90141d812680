#pragma once

/// Cost functions by automatic differentiation, with sizes at run time, for bundle/check.h.
///
/// A functor has the signature of ceres::DynamicAutoDiffCostFunction:
///
///   template <typename T>
///   bool operator()(T const* const* parameters, T* residuals) const;
///
/// Residuals are evaluated with T = Scalar, Jacobians with T = ceres::Jet<Scalar, N>. A check of
/// both finds what automatic differentiation misses: values that pass through double, branches with
/// another derivative, a Jet whose derivative is not finite. With Scalar = float, the functor is
/// checked in single precision. N is the number of all parameters.

#include <ceres/cost_function.h>
#include <ceres/jet.h>

#include <cstdint>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace bundle {

template <int N, typename Functor, typename Scalar = double>
class JetCost final : public ceres::CostFunction {
 public:
  /// Throws std::invalid_argument, in one line, if N is not the number of parameters.
  JetCost(Functor functor, const std::vector<int32_t>& block_sizes, int num_residuals)
      : functor_(std::move(functor)) {
    int total = 0;
    for (const int32_t size : block_sizes) total += size;
    if (total != N) {
      throw std::invalid_argument("Jet: expected " + std::to_string(total) +
                                  " derivatives, one per parameter, found " + std::to_string(N));
    }
    *mutable_parameter_block_sizes() = block_sizes;
    set_num_residuals(num_residuals);
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (jacobians == nullptr) return EvaluateAs<Scalar>(parameters, residuals, nullptr);
    return EvaluateAs<Scalar>(parameters, residuals, nullptr) &&
           EvaluateAs<ceres::Jet<Scalar, N>>(parameters, nullptr, jacobians);
  }

 private:
  static double Value(Scalar value) { return static_cast<double>(value); }

  template <typename T>
  bool EvaluateAs(double const* const* parameters, double* values, double** jacobians) const {
    std::vector<std::vector<T>> blocks;
    std::vector<const T*> pointers;
    int place = 0;
    for (const int32_t size : parameter_block_sizes()) {
      std::vector<T> block;
      for (int j = 0; j < size; ++j, ++place) {
        block.push_back(Start<T>(parameters[blocks.size()][j], place));
      }
      blocks.push_back(std::move(block));
    }
    for (const std::vector<T>& block : blocks) pointers.push_back(block.data());
    std::vector<T> residuals(num_residuals());
    if (!functor_(pointers.data(), residuals.data())) return false;
    if constexpr (std::is_same_v<T, Scalar>) {
      for (int i = 0; i < num_residuals(); ++i) values[i] = Value(residuals[i]);
    } else {
      place = 0;
      for (size_t b = 0; b < blocks.size(); place += parameter_block_sizes()[b++]) {
        const int size = parameter_block_sizes()[b];
        for (int i = 0; jacobians[b] != nullptr && i < num_residuals(); ++i) {
          for (int j = 0; j < size; ++j) {
            jacobians[b][i * size + j] = Value(residuals[i].v[place + j]);
          }
        }
      }
    }
    return true;
  }

  template <typename T>
  static T Start(double value, [[maybe_unused]] int place) {
    if constexpr (std::is_same_v<T, Scalar>) {
      return static_cast<Scalar>(value);
    } else {
      return T(static_cast<Scalar>(value), place);
    }
  }

  const Functor functor_;
};

}  // namespace bundle
