#include "core/solver/graph_jacobian.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/model/factor_costs.h"

namespace bundle {
namespace {

using Eigen::VectorXd;

constexpr double kNoFactorValue = std::numeric_limits<double>::quiet_NaN();

/// The rows of the factor's J, with its variables one after the other, in `j`.
bool EvaluateFactor(const Factor& factor, const GraphJacobian::Values& values,
                    std::vector<double>* j, std::vector<double>* r) {
  std::vector<const double*> pointers;
  for (const int b : factor.blocks()) pointers.push_back(values[b].data());
  std::vector<std::vector<double>> blocks;
  std::vector<double*> into;
  int width = 0;
  for (const Retraction& retraction : factor.retractions()) {
    blocks.emplace_back(r->size() * retraction.tangent_size());
    into.push_back(blocks.back().data());
    width += retraction.tangent_size();
  }
  const bool has_value =
      factor.Evaluate(pointers.data(), r->data(), j == nullptr ? nullptr : into.data());
  const auto is_finite = [](double value) { return std::isfinite(value); };
  if (!has_value || !std::all_of(r->begin(), r->end(), is_finite)) return false;
  if (j == nullptr) return true;
  j->resize(r->size() * width);
  int first = 0;
  for (size_t b = 0; b < blocks.size(); ++b) {
    const int size = factor.retractions()[b].tangent_size();
    for (size_t k = 0; k < r->size(); ++k) {
      std::copy_n(blocks[b].data() + k * size, size, j->data() + k * width + first);
    }
    first += size;
  }
  return std::all_of(j->begin(), j->end(), is_finite);
}

}  // namespace

GraphJacobian::GraphJacobian(const FactorGraph& graph) : graph_(graph) {
  for (const Block& block : graph.blocks) {
    column_.emplace_back();
    for (int i = 0; i < block.retraction.tangent_size(); ++i) {
      column_.back().push_back(block.IsHeld(i) ? -1 : num_columns_++);
    }
  }
  for (const auto& factor : graph.factors) num_rows_ += factor->num_residuals();
}

std::vector<int> GraphJacobian::sizes() const {
  std::vector<int> sizes;
  for (const Block& block : graph_.blocks) sizes.push_back(block.NumFree());
  return sizes;
}

std::vector<RowBlock> GraphJacobian::Rows(const Sparse& jacobian, const VectorXd& residual,
                                          const VectorXd& scale) const {
  std::vector<RowBlock> blocks;
  const Eigen::SparseMatrix<double, Eigen::RowMajor> by_rows = jacobian * scale.asDiagonal();
  int row = 0;
  for (const auto& factor : graph_.factors) {
    RowBlock block;
    std::vector<int> columns;
    for (const int b : factor->blocks()) {
      if (graph_.blocks[b].NumFree() == 0) continue;
      block.variables.push_back(b);
      for (const int column : column_[b]) {
        if (column >= 0) columns.push_back(column);
      }
    }
    const int rows = factor->num_residuals();
    block.matrix = Eigen::MatrixXd::Zero(rows, static_cast<Eigen::Index>(columns.size()) + 1);
    for (int k = 0; k < rows; ++k) {
      for (size_t c = 0; c < columns.size(); ++c) {
        block.matrix(k, static_cast<Eigen::Index>(c)) = by_rows.coeff(row + k, columns[c]);
      }
    }
    block.matrix.rightCols(1) = -residual.segment(row, rows);
    row += rows;
    blocks.push_back(std::move(block));
  }
  return blocks;
}

double GraphJacobian::Evaluate(const Values& values, VectorXd* residual, Sparse* jacobian) const {
  std::vector<Eigen::Triplet<double>> entries;
  std::vector<double> r, j;
  if (residual != nullptr) residual->resize(num_rows_);
  double cost = 0;
  int row = 0;
  for (const auto& factor : graph_.factors) {
    const int rows = factor->num_residuals();
    r.assign(rows, 0);
    if (!EvaluateFactor(*factor, values, residual == nullptr ? nullptr : &j, &r))
      return kNoFactorValue;
    const int width = residual == nullptr ? 0 : static_cast<int>(j.size()) / rows;
    cost += ApplyLoss(*factor, width, r.data(), residual == nullptr ? nullptr : j.data());
    if (residual != nullptr) {
      int first = 0;
      for (const int b : factor->blocks()) {
        for (const int column : column_[b]) {
          for (int k = 0; column >= 0 && k < rows; ++k) {
            entries.emplace_back(row + k, column, j[k * width + first]);
          }
          ++first;
        }
      }
      std::copy(r.begin(), r.end(), residual->data() + row);
    }
    row += rows;
  }
  if (jacobian != nullptr) {
    jacobian->resize(num_rows_, num_columns_);
    jacobian->setFromTriplets(entries.begin(), entries.end());
    jacobian->makeCompressed();
  }
  return cost;
}

void GraphJacobian::Move(const Values& from, const VectorXd& step, Values* to) const {
  std::vector<double> delta;
  for (size_t b = 0; b < column_.size(); ++b) {
    delta.clear();
    for (const int column : column_[b]) delta.push_back(column < 0 ? 0 : step[column]);
    graph_.blocks[b].retraction.Plus(from[b].data(), delta.data(), (*to)[b].data());
  }
}

double GraphJacobian::Norm(const Values& values) const {
  double sum = 0;
  for (size_t b = 0; b < values.size(); ++b) {
    if (graph_.blocks[b].NumFree() == 0) continue;
    for (const double value : values[b]) sum += value * value;
  }
  return std::sqrt(sum);
}

}  // namespace bundle
