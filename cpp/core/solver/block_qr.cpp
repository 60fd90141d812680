#include "core/solver/block_qr.h"

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>
#include <algorithm>
#include <limits>
#include <map>
#include <utility>

#include "core/dense/decompositions.h"

namespace bundle {

using Eigen::Index;
using Eigen::MatrixXd;
using Eigen::VectorXd;

BlockQr::BlockQr(std::vector<int> sizes, const std::vector<RowBlock>& rows,
                 const std::vector<int>& staying)
    : sizes_(std::move(sizes)), begin_{0}, num_eliminated_(sizes_.size() - staying.size()) {
  const auto n = static_cast<int>(sizes_.size());
  for (const int size : sizes_) begin_.push_back(begin_.back() + size);
  std::vector<bool> stays(n, false);
  for (const int v : staying) stays[v] = true;
  std::vector<Eigen::Triplet<double>> pattern;
  for (int v = 0; v < n; ++v) pattern.emplace_back(v, v, 1.0);
  for (const RowBlock& block : rows) {
    for (const int a : block.variables) {
      for (const int b : block.variables) {
        if (!stays[a] && !stays[b]) pattern.emplace_back(a, b, 1.0);
      }
    }
  }
  Eigen::SparseMatrix<double> graph(n, n);
  graph.setFromTriplets(pattern.begin(), pattern.end());
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> permutation;
  Eigen::AMDOrdering<int>()(graph, permutation);
  order_.assign(permutation.indices().data(), permutation.indices().data() + n);
  std::stable_partition(order_.begin(), order_.end(), [&](int v) { return !stays[v]; });
  position_.resize(n);
  for (int k = 0; k < n; ++k) position_[order_[k]] = k;
}

int BlockQr::Place(const RowBlock& block) const {
  int first = static_cast<int>(order_.size());
  for (const int v : block.variables) first = std::min(first, position_[v]);
  return first;
}

void BlockQr::Factorize(std::vector<RowBlock> rows) {
  std::vector<std::vector<RowBlock>> pending(order_.size());
  for (RowBlock& block : rows) {
    const int place = Place(block);
    if (place < static_cast<int>(order_.size())) pending[place].push_back(std::move(block));
  }
  r_.clear();
  rest_.clear();
  for (size_t k = 0; k < num_eliminated_; ++k) {
    RowBlock rest;
    r_.push_back(Eliminate(order_[k], std::move(pending[k]), &rest));
    if (rest.matrix.rows() > 0 && !rest.variables.empty()) {
      pending[Place(rest)].push_back(std::move(rest));
    }
  }
  for (size_t k = num_eliminated_; k < order_.size(); ++k) {
    for (RowBlock& block : pending[k]) rest_.push_back(std::move(block));
  }
}

BlockQr::Row BlockQr::Eliminate(int variable, std::vector<RowBlock> pending, RowBlock* rest) const {
  std::map<int, Index> column;  // first column of each variable of the front, by its position
  Index num_rows = 0;
  column[position_[variable]] = 0;
  for (const RowBlock& block : pending) {
    for (const int v : block.variables) column[position_[v]] = 0;
    num_rows += block.matrix.rows();
  }
  Row row;
  Index width = 0;
  for (auto& [position, first] : column) {
    first = width;
    width += sizes_[order_[position]];
    row.variables.push_back(order_[position]);
  }
  const Index size = sizes_[variable];
  MatrixXd front = MatrixXd::Zero(std::max(num_rows, size), width + 1);
  Index top = 0;
  for (const RowBlock& block : pending) {
    Index from = 0;
    const Index height = block.matrix.rows();
    for (const int v : block.variables) {
      front.block(top, column[position_[v]], height, sizes_[v]) =
          block.matrix.middleCols(from, sizes_[v]);
      from += sizes_[v];
    }
    front.block(top, width, height, 1) = block.matrix.col(from);
    top += height;
  }
  if (front.rows() > 2 * front.cols()) front = TriangleOfQr(front);
  if (size > 0) {
    MatrixXd others = front.rightCols(front.cols() - size);
    front.topLeftCorner(size, size) = ApplyQr(front.leftCols(size), &others);
    front.rightCols(front.cols() - size) = others;
  }
  row.matrix = front.topRows(size);
  rest->variables.assign(row.variables.begin() + 1, row.variables.end());
  rest->matrix = front.bottomRightCorner(front.rows() - size, front.cols() - size);
  return row;
}

VectorXd BlockQr::BackSubstitute(const VectorXd& right) const {
  VectorXd x(num_columns());
  for (size_t k = r_.size(); k-- > 0;) {
    const Row& row = r_[k];
    const int v = row.variables[0], size = sizes_[v];
    VectorXd side = right.segment(begin_[v], size);
    Index from = size;
    for (size_t i = 1; i < row.variables.size(); ++i) {
      const int other = row.variables[i];
      side -= row.matrix.middleCols(from, sizes_[other]) * x.segment(begin_[other], sizes_[other]);
      from += sizes_[other];
    }
    row.matrix.leftCols(size).triangularView<Eigen::Upper>().solveInPlace(side);
    x.segment(begin_[v], size) = side;
  }
  return x;
}

VectorXd BlockQr::Solve() const {
  VectorXd right(num_columns());
  for (const Row& row : r_) {
    right.segment(begin_[row.variables[0]], sizes_[row.variables[0]]) = row.matrix.rightCols(1);
  }
  return BackSubstitute(right);
}

VectorXd BlockQr::SolveNormal(const VectorXd& y) const {
  VectorXd z = y;
  for (const Row& row : r_) {
    const int v = row.variables[0], size = sizes_[v];
    VectorXd side = z.segment(begin_[v], size);
    row.matrix.leftCols(size).transpose().triangularView<Eigen::Lower>().solveInPlace(side);
    z.segment(begin_[v], size) = side;
    Index from = size;
    for (size_t i = 1; i < row.variables.size(); ++i) {
      const int other = row.variables[i];
      z.segment(begin_[other], sizes_[other]) -=
          row.matrix.middleCols(from, sizes_[other]).transpose() * side;
      from += sizes_[other];
    }
  }
  return BackSubstitute(z);
}

VectorXd BlockQr::Pivots() const {
  VectorXd pivots = VectorXd::Constant(num_columns(), std::numeric_limits<double>::infinity());
  for (const Row& row : r_) {
    const int v = row.variables[0];
    pivots.segment(begin_[v], sizes_[v]) = row.matrix.diagonal().head(sizes_[v]).cwiseAbs();
  }
  return pivots;
}

}  // namespace bundle
