#pragma once

#include <cstdint>
#include <vector>

namespace bundle {

/// A graph linearised at its values: r(x + d) ~ r + J d over all tangent coordinates, held or not,
/// the variables one after the other. With losses r and J are those that a solver sees.
struct LinearizedGraph {
  double cost = 0;  ///< 1/2 sum rho(||r||^2)
  std::vector<double> residual;
  std::vector<int> block_begin;    ///< first column of each variable, and the end
  std::vector<int64_t> row_begin;  ///< J by rows, compressed
  std::vector<int> columns;
  std::vector<double> values;
};

}  // namespace bundle
