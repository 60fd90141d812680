#include "core/linear/clusters.h"

/// Clusters start as single blocks. The most strongly coupled blocks are joined first, together
/// with their clusters, unless the joint cluster is too large. The coupling of blocks i and j is
///
///   sum over the entries of S_ij of s_kl^2 / (s_kk s_ll),
///
/// which is independent of units: the squared partial correlations of their unknowns.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>

namespace bundle {

namespace {

struct Coupling {
  double strength;
  int first, second;
};

std::vector<double> InverseDiagonal(const BlockStructure& structure, const BlockValues& values) {
  std::vector<double> inverse;
  inverse.reserve(structure.num_columns());
  structure.ForDiagonal([&](int, int64_t at) { inverse.push_back(1 / values[at]); });
  return inverse;
}

double Strength(const BlockStructure& structure, const BlockValues& values,
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

/// Strongest first.
std::vector<Coupling> FindCouplings(const BlockStructure& structure, const BlockValues& values) {
  const std::vector<double> inverse_diagonal = InverseDiagonal(structure, values);
  std::vector<Coupling> couplings;
  couplings.reserve(structure.row_block.size() - structure.num_blocks());
  for (int j = 0; j < structure.num_blocks(); ++j) {
    for (int64_t e = structure.column_begin[j] + 1; e < structure.column_begin[j + 1]; ++e) {
      const double strength = Strength(structure, values, inverse_diagonal, j, e);
      couplings.push_back({strength, j, structure.row_block[e]});
    }
  }
  std::sort(couplings.begin(), couplings.end(), [](const Coupling& a, const Coupling& b) {
    if (a.strength != b.strength) return a.strength > b.strength;
    return a.first != b.first ? a.first < b.first : a.second < b.second;
  });
  return couplings;
}

/// Disjoint sets, each named by one of its members (Tarjan, 1975; with path halving).
class Sets {
 public:
  explicit Sets(int count) : parent_(count), size_(count, 1) {
    std::iota(parent_.begin(), parent_.end(), 0);
  }

  int NameOf(int member) {
    while (parent_[member] != member) {
      parent_[member] = parent_[parent_[member]];
      member = parent_[member];
    }
    return member;
  }

  void JoinUpTo(int max_size, int a, int b) {
    a = NameOf(a);
    b = NameOf(b);
    if (a == b || size_[a] + size_[b] > max_size) return;
    if (size_[a] < size_[b]) std::swap(a, b);
    parent_[b] = a;
    size_[a] += size_[b];
  }

 private:
  std::vector<int> parent_;
  std::vector<int> size_;  ///< size of a set, by its name
};

}  // namespace

std::vector<int> ClusterBlocks(const BlockStructure& structure, const BlockValues& values,
                               const std::vector<char>& alone, int max_size) {
  Sets sets(structure.num_blocks());
  for (const Coupling& coupling : FindCouplings(structure, values)) {
    if (alone[coupling.first] != 0 || alone[coupling.second] != 0) continue;
    sets.JoinUpTo(max_size, coupling.first, coupling.second);
  }
  std::vector<int> number(structure.num_blocks(), -1);
  std::vector<int> cluster(structure.num_blocks());
  int num_clusters = 0;
  for (int j = 0; j < structure.num_blocks(); ++j) {
    int& of_set = number[sets.NameOf(j)];
    if (of_set < 0) of_set = num_clusters++;
    cluster[j] = of_set;
  }
  return cluster;
}

/// The columns of a cluster are made orthonormal in the metric diag(S), which makes radians,
/// lengths and pixels comparable and A = Q^T S Q well scaled. Columns that depend on earlier
/// columns are set to zero, and A gets a 1 on its diagonal there. For instance, a single image has
/// nine unknowns, but three intrinsics and seven similarities.

namespace {

/// Least norm of a direction after its components along earlier directions are subtracted.
constexpr double kIndependent = 1e-7;

constexpr int kNumGaugeDirections = BlockSystem::kNumGaugeDirections;

/// Gram-Schmidt, in the order of the columns.
void Orthonormalize(ClusterDirections* directions) {
  Eigen::MatrixXd& q = directions->q;
  directions->is_idle.resize(q.cols());
  for (int m = 0; m < q.cols(); ++m) {
    const double norm = q.col(m).norm();
    for (int pass = 0; pass < 2; ++pass) {  // twice is enough (Kahan and Parlett)
      for (int before = 0; before < m; ++before) {
        q.col(m) -= q.col(before).dot(q.col(m)) * q.col(before);
      }
    }
    const double left = q.col(m).norm();
    const bool idle = !(left > kIndependent * norm);
    directions->is_idle[m] = idle;
    if (idle) {
      q.col(m).setZero();
    } else {
      q.col(m) /= left;
    }
  }
}

}  // namespace

bool MovesBlock(const BlockStructure& structure, const std::vector<char>& moves, int block) {
  const auto first = moves.begin() + structure.offset[block];
  return std::any_of(first, first + structure.block_size(block),
                     [](char does_move) { return does_move != 0; });
}

ClusterDirections FindClusterDirections(const BlockStructure& structure, const BlockSystem& system,
                                        const std::vector<char>& moves,
                                        const std::vector<int>& blocks, int num_columns) {
  int num_rows = 0;
  for (const int j : blocks) num_rows += structure.block_size(j);
  ClusterDirections directions;
  directions.q = Eigen::MatrixXd::Zero(num_rows, num_columns);
  Eigen::VectorXd weight(num_rows);
  int row = 0;
  for (const int j : blocks) {
    int intrinsic = MovesBlock(structure, moves, j) ? kNumGaugeDirections : 0;
    for (int k = 0; k < structure.block_size(j); ++k, ++row) {
      const int column = structure.offset[j] + k;
      const int64_t diagonal = structure.ValueIndex(j, structure.column_begin[j], k, k);
      weight[row] = std::sqrt(system.values[diagonal]);
      if (moves[column] == 0) {
        directions.q(row, intrinsic++) = weight[row];
        continue;
      }
      const double* const gauge_directions =
          &system.gauge_directions[static_cast<size_t>(column) * kNumGaugeDirections];
      for (int m = 0; m < kNumGaugeDirections; ++m) {
        directions.q(row, m) = gauge_directions[m] * weight[row];
      }
    }
  }
  Orthonormalize(&directions);
  for (row = 0; row < num_rows; ++row) directions.q.row(row) /= weight[row];
  return directions;
}

}  // namespace bundle
