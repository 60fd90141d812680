/// Clusters grow one block at a time: from the first block without one, by the block that is
/// coupled most to what the cluster has already. The coupling of blocks i and j is
///
///   sum over the entries of S_ij of s_kl^2 / (s_kk s_ll),
///
/// which no units change: the squared partial correlations of their unknowns.

#include "core/fused/reduced/clusters.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>

namespace bundle::fused {
namespace {

struct Neighbour {
  int block;
  double coupling;
};

/// The neighbours of block i are those from begin[i] to begin[i + 1].
struct Couplings {
  std::vector<int64_t> begin;
  std::vector<Neighbour> neighbours;
};

std::vector<double> InverseDiagonal(const ReducedStructure& structure,
                                    const std::vector<double>& values) {
  std::vector<double> inverse;
  inverse.reserve(structure.num_columns());
  for (int j = 0; j < structure.num_blocks(); ++j) {
    for (int k = 0; k < structure.block_size(j); ++k) {
      inverse.push_back(1 / values[structure.ValueIndex(j, structure.column_begin[j], k, k)]);
    }
  }
  return inverse;
}

double Coupling(const ReducedStructure& structure, const std::vector<double>& values,
                const std::vector<double>& inverse_diagonal, int j, int64_t e) {
  const int i = structure.row_block[e];
  double sum = 0;
  for (int c = 0; c < structure.block_size(j); ++c) {
    const double* const column = &values[structure.ValueIndex(j, e, 0, c)];
    double column_sum = 0;
    for (int r = 0; r < structure.block_size(i); ++r) {
      column_sum += column[r] * column[r] * inverse_diagonal[structure.offset[i] + r];
    }
    sum += column_sum * inverse_diagonal[structure.offset[j] + c];
  }
  return std::isfinite(sum) ? sum : 0;
}

Couplings FindCouplings(const ReducedStructure& structure, const std::vector<double>& values) {
  const std::vector<double> inverse_diagonal = InverseDiagonal(structure, values);
  Couplings result;
  result.begin.assign(structure.num_blocks() + 1, 0);
  const auto for_each = [&](const auto& visit) {
    for (int j = 0; j < structure.num_blocks(); ++j) {
      for (int64_t e = structure.column_begin[j] + 1; e < structure.column_begin[j + 1]; ++e) {
        visit(structure.row_block[e], j, e);
      }
    }
  };
  for_each([&](int i, int j, int64_t) { ++result.begin[i + 1], ++result.begin[j + 1]; });
  std::partial_sum(result.begin.begin(), result.begin.end(), result.begin.begin());
  result.neighbours.resize(result.begin.back());
  std::vector<int64_t> next(result.begin.begin(), result.begin.end() - 1);
  for_each([&](int i, int j, int64_t e) {
    const double coupling = Coupling(structure, values, inverse_diagonal, j, e);
    result.neighbours[next[i]++] = {j, coupling};
    result.neighbours[next[j]++] = {i, coupling};
  });
  return result;
}

}  // namespace

std::vector<int> ClusterBlocks(const ReducedStructure& structure, const std::vector<double>& values,
                               const std::vector<char>& alone, int max_size) {
  const Couplings couplings = FindCouplings(structure, values);
  std::vector<int> cluster(structure.num_blocks(), -1);
  std::vector<double> strength(structure.num_blocks(), -1);  // of the blocks next to the cluster
  std::vector<int> candidates;
  int num_clusters = 0;
  for (int seed = 0; seed < structure.num_blocks(); ++seed) {
    if (cluster[seed] >= 0) continue;
    int block = seed;
    for (int size = 1; block >= 0; ++size) {
      cluster[block] = num_clusters;
      if (size == max_size || alone[seed]) break;
      for (int64_t k = couplings.begin[block]; k < couplings.begin[block + 1]; ++k) {
        const Neighbour& neighbour = couplings.neighbours[k];
        if (cluster[neighbour.block] >= 0 || alone[neighbour.block]) continue;
        if (strength[neighbour.block] < 0) {
          strength[neighbour.block] = 0;
          candidates.push_back(neighbour.block);
        }
        strength[neighbour.block] += neighbour.coupling;
      }
      block = -1;
      for (const int candidate : candidates) {
        if (cluster[candidate] >= 0) continue;
        if (block < 0 || strength[candidate] > strength[block]) block = candidate;
      }
    }
    for (const int candidate : candidates) strength[candidate] = -1;
    candidates.clear();
    ++num_clusters;
  }
  return cluster;
}

}  // namespace bundle::fused
