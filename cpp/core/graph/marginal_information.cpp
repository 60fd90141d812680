#include "core/graph/marginal_information.h"

#include <Eigen/Sparse>
#include <cmath>
#include <limits>

#include "core/error.h"

namespace bundle {
namespace {

using Sparse = Eigen::SparseMatrix<double>;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Factorization = Eigen::SimplicialLDLT<Sparse, Eigen::Lower, Eigen::AMDOrdering<int>>;

/// A pivot beside the diagonal's 1 below which it is rounding.
double SmallestPivot(Eigen::Index n) {
  return 16 * static_cast<double>(n) * std::numeric_limits<double>::epsilon();
}

/// The columns of J that are eliminated and kept, and the rows that touch any.
struct Split {
  Sparse eliminated, kept;
  std::vector<int> eliminated_block;  ///< of each eliminated column
};

Split SplitColumns(const std::vector<int>& kept, const std::vector<Block>& blocks,
                   const LinearizedGraph& graph) {
  constexpr int kDropped = -1;
  Split split;
  std::vector<bool> is_kept(blocks.size(), false);
  // Kept columns are numbered from 0 on, eliminated ones from -2 down.
  std::vector<int> place(graph.block_begin.back(), kDropped);
  int num_kept = 0;
  for (const int b : kept) {
    is_kept[b] = true;
    for (int c = graph.block_begin[b]; c < graph.block_begin[b + 1]; ++c) place[c] = num_kept++;
  }
  for (size_t b = 0; b < blocks.size(); ++b) {
    if (is_kept[b]) continue;
    for (int c = graph.block_begin[b]; c < graph.block_begin[b + 1]; ++c) {
      if (blocks[b].IsHeld(c - graph.block_begin[b])) continue;
      place[c] = -2 - static_cast<int>(split.eliminated_block.size());
      split.eliminated_block.push_back(static_cast<int>(b));
    }
  }
  std::vector<Eigen::Triplet<double>> to_kept, to_eliminated;
  const int num_rows = static_cast<int>(graph.residual.size());
  for (int r = 0; r < num_rows; ++r) {
    for (int64_t k = graph.row_begin[r]; k < graph.row_begin[r + 1]; ++k) {
      const int column = place[graph.columns[k]];
      if (column >= 0) to_kept.emplace_back(r, column, graph.values[k]);
      if (column < kDropped) to_eliminated.emplace_back(r, -2 - column, graph.values[k]);
    }
  }
  split.kept.resize(num_rows, num_kept);
  split.kept.setFromTriplets(to_kept.begin(), to_kept.end());
  split.eliminated.resize(num_rows, static_cast<int>(split.eliminated_block.size()));
  split.eliminated.setFromTriplets(to_eliminated.begin(), to_eliminated.end());
  return split;
}

/// Names a variable in a direction that nothing determines. A shift lets the factorisation finish;
/// the pivot of such a direction is about as small as the shift.
[[noreturn]] void RefuseUndetermined(const Sparse& scaled, const std::vector<int>& column_block,
                                     const std::vector<Block>& blocks) {
  Factorization shifted;
  shifted.setShift(1e-8);
  shifted.compute(scaled);
  Eigen::Index pivot = 0;
  shifted.vectorD().minCoeff(&pivot);
  const int column = shifted.permutationPinv().indices()[pivot];
  throw InputError(blocks[column_block[column]].name +
                   ": expected factors that determine what is eliminated, found a direction that "
                   "none does");
}

}  // namespace

MarginalInformation MarginalizeOnto(const std::vector<int>& kept, const std::vector<Block>& blocks,
                                    const LinearizedGraph& graph) {
  const Split split = SplitColumns(kept, blocks, graph);
  const Eigen::Map<const Eigen::VectorXd> residual(
      graph.residual.data(), static_cast<Eigen::Index>(graph.residual.size()));
  const Eigen::Index n = split.kept.cols(), m = split.eliminated.cols();
  RowMajor lambda = RowMajor(Sparse(split.kept.transpose() * split.kept));
  Eigen::VectorXd eta = -(split.kept.transpose() * residual);
  if (m > 0) {
    Sparse scaled = split.eliminated;
    Eigen::VectorXd scale(m);
    for (Eigen::Index c = 0; c < m; ++c) {
      const double norm = scaled.col(c).norm();
      scale[c] = norm > 0 ? 1 / norm : 1;
    }
    scaled = scaled * scale.asDiagonal();
    const Sparse normal = scaled.transpose() * scaled;
    Factorization factorization(normal);
    if (factorization.info() != Eigen::Success ||
        !(factorization.vectorD().minCoeff() > SmallestPivot(m))) {
      RefuseUndetermined(normal, split.eliminated_block, blocks);
    }
    // The columns kept and eta side by side: solved by the same triangle.
    Eigen::MatrixXd sides(m, n + 1);
    sides.leftCols(n) = Eigen::MatrixXd(Sparse(scaled.transpose() * split.kept));
    sides.col(n) = -(scaled.transpose() * residual);
    sides = factorization.permutationP() * sides;
    factorization.matrixL().solveInPlace(sides);
    sides = factorization.vectorD().cwiseSqrt().cwiseInverse().asDiagonal() * sides;
    lambda.noalias() -= sides.leftCols(n).transpose() * sides.leftCols(n);
    eta.noalias() -= sides.leftCols(n).transpose() * sides.col(n);
  }
  MarginalInformation result;
  result.lambda.resize(static_cast<size_t>(n * n));
  result.eta.assign(eta.data(), eta.data() + n);
  for (Eigen::Index r = 0; r < n; ++r) {
    for (Eigen::Index c = 0; c <= r; ++c) {
      result.lambda[r * n + c] = result.lambda[c * n + r] = lambda(r, c);
    }
  }
  return result;
}

}  // namespace bundle
