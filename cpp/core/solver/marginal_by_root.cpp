#include "core/solver/marginal_by_root.h"

/// Marginal information by a square root. With J_a and J_b the columns of the whitened Jacobian for
/// eliminated and kept variables, Householder reflections give
///
///   Q^T [J_a  J_b  -r] = [R_a  R_ab  d_a]
///                        [ 0    A     d ],
///
/// so that the cost minimised over d_a is 1/2 ||A d_b - d||^2 and a constant:
///
///   Lambda' = A^T A,        eta' = A^T d.
///
/// No difference of large numbers is formed, so that Lambda' is positive semidefinite. It loses
/// log10 of the condition of J_a in digits; normal equations lose twice as many
/// (graph/dense_marginals.py does the same with dense matrices). solver/block_qr.h has the sparse
/// factorisation. Columns have norm 1, so that a pivot at rounding level is recognised in any
/// units; Lambda' is scaled back.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>

#include "core/dense/decompositions.h"
#include "core/error.h"
#include "core/solver/block_qr.h"

namespace bundle {
namespace {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

/// Columns of the tangent coordinates of a graph.
struct Columns {
  std::vector<int> variable;  ///< per coordinate: its variable
  std::vector<int> place;     ///< per coordinate: its column within the variable; -1: constant
  std::vector<int> size;      ///< per variable: number of its free columns
  std::vector<double> scale;  ///< per coordinate: inverse norm of its column
};

Columns FindColumns(const std::vector<int>& kept, const std::vector<Block>& blocks,
                    const LinearizedGraph& graph) {
  std::vector<bool> is_kept(blocks.size(), false);
  for (const int b : kept) is_kept[b] = true;
  Columns columns;
  for (size_t b = 0; b < blocks.size(); ++b) {
    int size = 0;
    for (int i = 0; i < blocks[b].retraction.tangent_size(); ++i) {
      const bool is_held = !is_kept[b] && blocks[b].IsHeld(i);
      columns.variable.push_back(static_cast<int>(b));
      columns.place.push_back(is_held ? -1 : size++);
    }
    columns.size.push_back(size);
  }
  columns.scale.assign(columns.place.size(), 0);
  for (size_t k = 0; k < graph.values.size(); ++k) {
    columns.scale[graph.columns[k]] += graph.values[k] * graph.values[k];
  }
  for (double& scale : columns.scale) scale = scale > 0 ? 1 / std::sqrt(scale) : 1;
  return columns;
}

std::vector<RowBlock> MakeRows(const LinearizedGraph& graph, const Columns& columns) {
  std::vector<RowBlock> rows;
  for (size_t r = 0; r < graph.residual.size(); ++r) {
    RowBlock row;
    std::vector<int> first;  // first column of each variable
    int width = 0;
    std::vector<std::pair<int, double>> entries;
    for (int64_t k = graph.row_begin[r]; k < graph.row_begin[r + 1]; ++k) {
      const int c = graph.columns[k], variable = columns.variable[c];
      if (columns.place[c] < 0) continue;
      if (row.variables.empty() || row.variables.back() != variable) {
        row.variables.push_back(variable);
        first.push_back(width);
        width += columns.size[variable];
      }
      entries.emplace_back(first.back() + columns.place[c], graph.values[k] * columns.scale[c]);
    }
    if (row.variables.empty()) continue;
    row.matrix = MatrixXd::Zero(1, width + 1);
    for (const auto& [column, value] : entries) row.matrix(0, column) = value;
    row.matrix(0, width) = -graph.residual[r];
    rows.push_back(std::move(row));
  }
  return rows;
}

void RefuseUndetermined(const BlockQr& qr, const Columns& columns,
                        const std::vector<Block>& blocks) {
  const VectorXd pivots = qr.Pivots();
  Index smallest = 0;
  if (pivots.size() == 0) return;
  const double rounding =
      16 * static_cast<double>(pivots.size()) * std::numeric_limits<double>::epsilon();
  if (pivots.minCoeff(&smallest) > rounding) return;
  Index end = 0;
  for (size_t b = 0; b < blocks.size(); ++b) {
    end += columns.size[b];
    if (smallest < end) {
      throw InputError(blocks[b].name +
                       ": expected factors that determine the eliminated variables, found an "
                       "undetermined direction");
    }
  }
}

MarginalInformation MarginalizeByRoot(const std::vector<int>& kept,
                                      const std::vector<Block>& blocks,
                                      const LinearizedGraph& graph) {
  const Columns columns = FindColumns(kept, blocks, graph);
  std::vector<RowBlock> rows = MakeRows(graph, columns);
  BlockQr qr(columns.size, rows, kept);
  qr.Factorize(std::move(rows));
  RefuseUndetermined(qr, columns, blocks);

  std::vector<Index> first(blocks.size(), 0);
  Index n = 0, height = 0;
  for (const int b : kept) first[b] = std::exchange(n, n + columns.size[b]);
  for (const RowBlock& block : qr.rest()) height += block.matrix.rows();
  MatrixXd root = MatrixXd::Zero(std::max(height, n + 1), n + 1);
  Index top = 0;
  for (const RowBlock& block : qr.rest()) {
    Index from = 0;
    for (const int b : block.variables) {
      root.block(top, first[b], block.matrix.rows(), columns.size[b]) =
          block.matrix.middleCols(from, columns.size[b]);
      from += columns.size[b];
    }
    root.block(top, n, block.matrix.rows(), 1) = block.matrix.rightCols(1);
    top += block.matrix.rows();
  }
  root = TriangleOfQr(root);
  for (const int b : kept) {
    for (int i = 0; i < columns.size[b]; ++i) {
      root.col(first[b] + i) /= columns.scale[graph.block_begin[b] + i];
    }
  }
  const MatrixXd products = MultiplyTransposed(root, root);
  MarginalInformation result;
  for (Index r = 0; r < n; ++r) {
    // Copies the lower triangle to the upper one, for exact symmetry.
    for (Index c = 0; c < n; ++c) {
      result.lambda.push_back(products(std::max(r, c), std::min(r, c)));
    }
    result.eta.push_back(products(n, r));
  }
  return result;
}

}  // namespace

MarginalInformation FindMarginalInformation(const std::vector<int>& kept,
                                            const std::vector<Block>& blocks,
                                            const LinearizedGraph& graph) {
  MarginalInformation found = MarginalizeOnto(kept, blocks, graph);
  return found.is_certain ? found : MarginalizeByRoot(kept, blocks, graph);
}

}  // namespace bundle
