#include "core/diagnosis/graph_normal_equations.h"

#include <algorithm>
#include <cmath>

#include "core/dense/decompositions.h"
#include "core/linear/direct_solvers.h"
#include "core/linear/fill_ordering.h"

namespace bundle {

using Eigen::MatrixXd;
using Eigen::VectorXd;

GraphNormalEquations::GraphNormalEquations(const FactorGraph& graph, const LinearizedGraph& linear,
                                           std::vector<uint8_t> held, int num_threads)
    : graph_(graph), linear_(linear) {
  first_row_.push_back(0);
  for (const auto& factor : graph.factors) {
    first_row_.push_back(first_row_.back() + factor->num_residuals());
  }
  FindColumns(held);
  const BlockStructure natural = NaturalStructure();
  const FillOrdering ordering = FindFillOrdering(natural);
  structure_ = Reorder(natural, ordering.order);
  solver_ = MakeSparseSolver(ordering, num_threads, &structure_);
  compact_ = CompactStructure(structure_);
  std::vector<int> with_block;
  for (size_t v = 0; v < num_free_.size(); ++v) {
    if (num_free_[v] > 0) with_block.push_back(static_cast<int>(v));
  }
  block_.assign(num_free_.size(), -1);
  place_.resize(coordinates_.size());
  for (size_t k = 0; k < ordering.order.size(); ++k) {
    const int variable = with_block[ordering.order[k]];
    variable_of_.push_back(variable);
    block_[variable] = static_cast<int>(k);
    for (int c = 0; c < num_free_[variable]; ++c) {
      place_[first_column_[variable] + c] = structure_.offset[k] + c;
    }
  }
  Assemble();
}

void GraphNormalEquations::FindColumns(const std::vector<uint8_t>& held) {
  column_.assign(held.size(), -1);
  for (size_t v = 0; v < graph_.blocks.size(); ++v) {
    first_column_.push_back(-1);
    num_free_.push_back(0);
    for (int c = linear_.block_begin[v]; c < linear_.block_begin[v + 1]; ++c) {
      if (held[c] != 0) continue;
      if (num_free_[v]++ == 0) first_column_[v] = static_cast<int>(coordinates_.size());
      column_[c] = static_cast<int>(coordinates_.size());
      coordinates_.push_back(c);
    }
  }
}

BlockStructure GraphNormalEquations::NaturalStructure() const {
  std::vector<int> sizes, block(num_free_.size(), -1);
  for (size_t v = 0; v < num_free_.size(); ++v) {
    if (num_free_[v] == 0) continue;
    block[v] = static_cast<int>(sizes.size());
    sizes.push_back(num_free_[v]);
  }
  std::vector<std::vector<int>> columns(sizes.size());
  for (size_t b = 0; b < sizes.size(); ++b) columns[b].push_back(static_cast<int>(b));
  for (const auto& factor : graph_.factors) {
    for (const int i : factor->blocks()) {
      for (const int j : factor->blocks()) {
        if (block[i] >= 0 && block[j] > block[i]) columns[block[i]].push_back(block[j]);
      }
    }
  }
  for (std::vector<int>& rows : columns) {
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  }
  return SparseStructure(sizes, columns);
}

GraphNormalEquations::Rows GraphNormalEquations::RowsOf(int64_t factor) const {
  Rows rows;
  std::vector<int> begin;
  int width = 0;
  for (const int v : graph_.factors[factor]->blocks()) {
    if (num_free_[v] == 0) continue;
    rows.variables.push_back(v);
    begin.push_back(width - first_column_[v]);
    width += num_free_[v];
  }
  const int64_t first = first_row_[factor], count = first_row_[factor + 1] - first;
  rows.jacobian = MatrixXd::Zero(count, width);
  rows.residual.resize(count);
  for (int64_t r = 0; r < count; ++r) {
    rows.residual[r] = linear_.residual[first + r];
    for (int64_t k = linear_.row_begin[first + r]; k < linear_.row_begin[first + r + 1]; ++k) {
      const int column = column_[linear_.columns[k]];
      if (column < 0) continue;
      size_t b = 0;
      while (column < first_column_[rows.variables[b]] ||
             column >= first_column_[rows.variables[b]] + num_free_[rows.variables[b]]) {
        ++b;
      }
      rows.jacobian(r, begin[b] + column) = linear_.values[k];
    }
  }
  return rows;
}

void GraphNormalEquations::Assemble() {
  values_.assign(compact_.num_values, 0.0);
  descent_ = VectorXd::Zero(num_columns());
  for (int64_t f = 0; f < static_cast<int64_t>(graph_.factors.size()); ++f) {
    const Rows rows = RowsOf(f);
    const MatrixXd h = MultiplyTransposed(rows.jacobian, rows.jacobian);
    const VectorXd g = rows.jacobian.transpose() * rows.residual;
    int at_i = 0;
    for (const int i : rows.variables) {
      descent_.segment(first_column_[i], num_free_[i]) -= g.segment(at_i, num_free_[i]);
      int at_j = 0;
      for (const int j : rows.variables) {
        const int column = block_[i], row = block_[j];
        if (row >= column) {
          const int64_t entry = compact_.Entry(column, row);
          for (int c = 0; c < num_free_[i]; ++c) {
            for (int r = row == column ? c : 0; r < num_free_[j]; ++r) {
              values_[compact_.ValueIndex(column, entry, r, c)] += h(at_j + r, at_i + c);
            }
          }
        }
        at_j += num_free_[j];
      }
      at_i += num_free_[i];
    }
  }
  VectorXd by_place(num_columns());
  compact_.ForDiagonal([&](int column, int64_t at) {
    by_place[column] = values_[at] > 0 ? 1 / std::sqrt(values_[at]) : 1;
  });
  for (int k = 0; k < compact_.num_blocks(); ++k) {
    for (int64_t e = compact_.column_begin[k]; e < compact_.column_begin[k + 1]; ++e) {
      const int row = compact_.row_block[e];
      for (int c = 0; c < compact_.block_size(k); ++c) {
        for (int r = 0; r < compact_.block_size(row); ++r) {
          values_[compact_.ValueIndex(k, e, r, c)] *=
              by_place[compact_.offset[k] + c] * by_place[compact_.offset[row] + r];
        }
      }
    }
  }
  scale_ = by_place(place_);
}

int GraphNormalEquations::Factorize(double shift) {
  system_.values.assign(structure_.num_values, 0.0);
  AddBlocks(compact_, values_.data(), structure_, system_.values.data());
  structure_.ForDiagonal([&](int, int64_t at) { system_.values[at] += shift; });
  const LinearSolution done = solver_->Factorize(&system_, {});
  if (done.status == LinearStatus::kSuccess) return -1;
  return variable_of_[structure_.BlockOf(std::max(done.failed_minor - 1, 0))];
}

MatrixXd GraphNormalEquations::Solve(const MatrixXd& x) {
  MatrixXd permuted(x.rows(), x.cols()), solved(x.rows(), x.cols());
  permuted(place_, Eigen::all) = x;
  solver_->Solve(permuted.data(), static_cast<int>(x.cols()), 0, solved.data());
  return solved(place_, Eigen::all);
}

MatrixXd GraphNormalEquations::Product(const MatrixXd& x) const {
  MatrixXd all = MatrixXd::Zero(static_cast<Eigen::Index>(column_.size()), x.cols());
  all(coordinates_, Eigen::all) = x;
  return ProductOfAll(all)(coordinates_, Eigen::all);
}

MatrixXd GraphNormalEquations::ProductOfAll(const MatrixXd& x) const {
  MatrixXd result = MatrixXd::Zero(x.rows(), x.cols());
  for (Eigen::Index c = 0; c < x.cols(); ++c) {
    const auto from = x.col(c);
    auto to = result.col(c);
    for (size_t r = 0; r < linear_.residual.size(); ++r) {
      const int64_t begin = linear_.row_begin[r], end = linear_.row_begin[r + 1];
      double along = 0;
      for (int64_t k = begin; k < end; ++k) along += linear_.values[k] * from[linear_.columns[k]];
      for (int64_t k = begin; k < end; ++k) to[linear_.columns[k]] += linear_.values[k] * along;
    }
  }
  return result;
}

void GraphNormalEquations::Invert() { solver_->InvertBlocks(); }

MatrixXd GraphNormalEquations::InverseBlock(int row, int column) const {
  const int of_row = block_[row], of_column = block_[column];
  if (of_row < of_column) return InverseBlock(column, row).transpose();
  MatrixXd block(num_free_[row], num_free_[column]);
  const int64_t entry = structure_.Entry(of_column, of_row);
  for (int c = 0; c < block.cols(); ++c) {
    for (int r = 0; r < block.rows(); ++r) {
      const bool lower = of_row != of_column || r >= c;
      const double value = system_.values[lower ? structure_.ValueIndex(of_column, entry, r, c)
                                                : structure_.ValueIndex(of_column, entry, c, r)];
      block(r, c) = value * scale_[first_column_[row] + r] * scale_[first_column_[column] + c];
    }
  }
  return block;
}

}  // namespace bundle
