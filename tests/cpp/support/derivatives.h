#pragma once

/// Derivatives of factors against differences.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/ceres/gradient_check.h"
#include "core/factors/factor.h"

namespace bundle::testing {

/// All Jacobians against Ridders' extrapolation, in units of the largest entry.
inline void ExpectDerivativesOf(const Factor& factor,
                                const std::vector<std::vector<double>>& values) {
  std::vector<std::vector<double>> given;
  std::vector<const double*> pointers;
  std::vector<double*> blocks;
  FunctionAtPoint at;
  at.num_residuals = factor.num_residuals();
  int columns = 0;
  for (size_t b = 0; b < values.size(); ++b) {
    const int size = factor.retractions()[b].tangent_size();
    given.emplace_back(factor.num_residuals() * size);
    at.blocks.emplace_back(size, 0.0);
    at.manifolds.push_back({"euclidean", {}});
    pointers.push_back(values[b].data());
    columns += size;
  }
  for (std::vector<double>& block : given) blocks.push_back(block.data());
  at.function = [&](double const* const* steps, double* residual, double** /*jacobians*/) {
    std::vector<std::vector<double>> moved = values;
    std::vector<const double*> there;
    for (size_t b = 0; b < moved.size(); ++b) {
      factor.retractions()[b].Plus(values[b].data(), steps[b], moved[b].data());
      there.push_back(moved[b].data());
    }
    return factor.Evaluate(there.data(), residual, nullptr);
  };
  std::vector<double> residual(factor.num_residuals());
  ASSERT_TRUE(factor.Evaluate(pointers.data(), residual.data(), blocks.data()));
  const ReferenceJacobians reference = DifferentiateByRichardson(at);
  double scale = 0;
  for (const double value : reference.ambient.values) scale = std::max(scale, std::abs(value));
  int first = 0;
  for (size_t b = 0; b < values.size(); ++b) {
    const int size = factor.retractions()[b].tangent_size();
    for (int r = 0; r < factor.num_residuals(); ++r) {
      for (int c = 0; c < size; ++c) {
        EXPECT_NEAR(given[b][r * size + c], reference.ambient.values[r * columns + first + c],
                    1e-6 * scale)
            << "block " << b << " row " << r << " column " << c;
      }
    }
    first += size;
  }
}

}  // namespace bundle::testing
