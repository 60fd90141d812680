#pragma once

/// Covariances of the variables of a factor graph, redundancy of its factors, and the spectrum of
/// its normal equations (derived in factor_graph_certainty.cpp).

#include <cstdint>
#include <utility>
#include <vector>

#include "core/graph/factor_graph.h"

namespace bundle {

/// Row-major.
struct PlainMatrix {
  int64_t rows = 0, columns = 0;
  std::vector<double> values;
};

struct FactorGraphRequest {
  std::vector<uint8_t> held;               ///< per tangent coordinate: 1 if constant
  std::vector<std::pair<int, int>> pairs;  ///< pairs of variables, for their cross-covariance
  /// Null directions of the graph at held coordinates, one per column; zero elsewhere. Empty
  /// without inner constraints.
  PlainMatrix null_seed;
  bool of_factors = false;  ///< compute redundancies and tests, too
  int num_threads = 1;
};

/// By tangent coordinates; zero at constant ones.
struct FactorGraphCertainty {
  std::vector<PlainMatrix> variables;  ///< covariance of each variable
  std::vector<PlainMatrix> across;     ///< covariance of the first with the second of each pair
  /// Per factor: see GraphCovarianceOutput (pose_graph/graph_covariance.h).
  std::vector<double> redundancy, test;
  std::vector<int32_t> rank;
  double predicted_decrease = 0;  ///< decrease of the cost by one more step, predicted
  /// Largest ratio of a variance to the variance with all other unknowns known.
  double inflation = 1;
  /// Variable at which the factorisation failed; other members are then empty.
  int undetermined = -1;
};

FactorGraphCertainty ComputeFactorGraphCertainty(const FactorGraph& graph,
                                                 const LinearizedGraph& linear,
                                                 const FactorGraphRequest& request);

struct FactorGraphSpectrum {
  /// Lowest eigenvalues of S = D H D, ascending, after the null directions.
  std::vector<double> eigenvalues;
  PlainMatrix null_directions;  ///< by tangent coordinates, a column each, not scaled
  PlainMatrix directions;       ///< eigenvectors of `eigenvalues`, likewise
  double condition_number = 0, condition_number_unscaled = 0;  ///< those of the determined part
};

/// `num_null`: dimension of the null space.
FactorGraphSpectrum FindFactorGraphSpectrum(const FactorGraph& graph, const LinearizedGraph& linear,
                                            std::vector<uint8_t> held, int num_null,
                                            int num_threads);

}  // namespace bundle
