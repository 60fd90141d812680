#include "core/graph/factor_graph.h"

#include <Eigen/Sparse>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "core/dense/decompositions.h"
#include "core/error.h"
#include "core/factors/factor.h"
#include "core/words.h"

namespace bundle {

namespace {

void CheckBounds(const Block& block) {
  if (block.lower.empty() && block.upper.empty()) return;
  if (block.retraction.manifold() != Manifold::kEuclidean) {
    throw InputError(block.name + ": bounds: expected a euclidean variable, found " +
                     block.retraction.name());
  }
  const size_t n = block.value.size();
  if (block.lower.size() != n || block.upper.size() != n) {
    throw InputError(block.name + ": bounds: expected " +
                     Counted(static_cast<int64_t>(n), "number") + ", found " +
                     std::to_string(std::min(block.lower.size(), block.upper.size())));
  }
  for (size_t i = 0; i < n; ++i) {
    // A NaN bound fails both comparisons.
    if (block.lower[i] <= block.value[i] && block.value[i] <= block.upper[i]) continue;
    throw InputError(block.name + ": expected a start within its bounds, found " +
                     ShortNumber(block.value[i]) + " at [" + std::to_string(i) + "], bounds " +
                     ShortNumber(block.lower[i]) + " to " + ShortNumber(block.upper[i]));
  }
}

}  // namespace

void CheckBlock(const Block& block) {
  CheckedValue(block.name, block.retraction, block.value);
  if (!block.held.empty() &&
      static_cast<int>(block.held.size()) != block.retraction.tangent_size()) {
    throw InputError(block.name + ": held: expected " +
                     Counted(block.retraction.tangent_size(), "flag") + ", found " +
                     std::to_string(block.held.size()));
  }
  CheckBounds(block);
}

void CheckVariables(const Factor& factor, const std::vector<Block>& blocks) {
  const auto& indices = factor.blocks();
  if (indices.size() != factor.retractions().size()) {
    throw InputError(factor.name() + ": expected " +
                     Counted(static_cast<int64_t>(factor.retractions().size()), "variable") +
                     ", found " + std::to_string(indices.size()));
  }
  for (size_t b = 0; b < indices.size(); ++b) {
    if (indices[b] < 0 || indices[b] >= static_cast<int>(blocks.size())) {
      throw InputError(factor.name() + ": there is no variable " + std::to_string(indices[b]));
    }
    const Block& block = blocks[indices[b]];
    if (std::find(indices.begin(), indices.begin() + b, indices[b]) != indices.begin() + b) {
      throw InputError(factor.name() + ": " + block.name + ": expected different variables, " +
                       "found it twice");
    }
    const Retraction& expected = factor.retractions()[b];
    if (block.retraction == expected) continue;
    throw InputError(factor.name() + ": " + block.name + ": expected " + expected.name() + " of " +
                     Counted(expected.ambient_size(), "number") + ", found " +
                     block.retraction.name() + " of " +
                     std::to_string(block.retraction.ambient_size()));
  }
}

void CheckEvaluation(const Factor& factor, const std::vector<Block>& blocks) {
  const size_t num_blocks = factor.blocks().size();
  std::vector<double> residual(factor.num_residuals());
  std::vector<std::vector<double>> storage(num_blocks);
  std::vector<double*> jacobians(num_blocks);
  for (size_t b = 0; b < num_blocks; ++b) {
    storage[b].resize(residual.size() * factor.retractions()[b].tangent_size());
    jacobians[b] = storage[b].data();
  }
  const auto values = ValuesOf(factor, blocks);
  if (!factor.Evaluate(values.data(), residual.data(), jacobians.data())) {
    throw InputError(factor.name() + ": expected a finite residual at the start, found no value");
  }
  for (size_t r = 0; r < residual.size(); ++r) {
    if (std::isfinite(residual[r])) continue;
    throw InputError(factor.name() + ": expected a finite residual at the start, found " +
                     std::to_string(residual[r]) + " in row " + std::to_string(r));
  }
  for (size_t b = 0; b < num_blocks; ++b) {
    const auto bad = std::find_if(storage[b].begin(), storage[b].end(),
                                  [](double value) { return !std::isfinite(value); });
    if (bad == storage[b].end()) continue;
    const int columns = factor.retractions()[b].tangent_size();
    const int place = static_cast<int>(bad - storage[b].begin());
    throw InputError(factor.name() + ": " + blocks[factor.blocks()[b]].name +
                     ": expected a finite Jacobian at the start, found " + std::to_string(*bad) +
                     " in row " + std::to_string(place / columns) + ", column " +
                     std::to_string(place % columns));
  }
}

std::vector<const double*> ValuesOf(const Factor& factor, const std::vector<Block>& blocks) {
  std::vector<const double*> values;
  for (const int b : factor.blocks()) values.push_back(blocks[b].value.data());
  return values;
}

void ValidateGraph(const FactorGraph& graph) {
  if (graph.factors.empty()) throw InputError("factor graph: expected factors, found 0");
  std::vector<bool> has_factor(graph.blocks.size(), false);
  for (const Block& block : graph.blocks) CheckBlock(block);
  for (const auto& factor : graph.factors) {
    CheckVariables(*factor, graph.blocks);
    for (const int b : factor->blocks()) has_factor[b] = true;
  }
  for (size_t b = 0; b < graph.blocks.size(); ++b) {
    if (has_factor[b] || graph.blocks[b].NumFree() == 0) continue;
    throw InputError(graph.blocks[b].name +
                     ": expected at least one factor of this variable, found 0");
  }
  for (const auto& factor : graph.factors) CheckEvaluation(*factor, graph.blocks);
}

namespace {

using Sparse = Eigen::SparseMatrix<double>;
using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Factorization = Eigen::SimplicialLDLT<Sparse, Eigen::Lower, Eigen::AMDOrdering<int>>;

/// Limit for an eigenvalue or a pivot, with a diagonal of 1. Below it, differences leave fewer than
/// about ten digits.
constexpr double kLeastCertain = 1e-6;

/// Limit for a pivot, with a diagonal of 1. Below it, a pivot is rounding.
double SmallestPivot(Eigen::Index n) {
  return 16 * static_cast<double>(n) * std::numeric_limits<double>::epsilon();
}

/// The eliminated and the kept columns of J, and the rows that contain any of them.
struct Split {
  Sparse eliminated, kept;
};

Split SplitColumns(const std::vector<int>& kept, const std::vector<Block>& blocks,
                   const LinearizedGraph& graph) {
  constexpr int kDropped = -1;
  Split split;
  std::vector<bool> is_kept(blocks.size(), false);
  // Kept columns are numbered from 0 on, eliminated ones from -2 down.
  std::vector<int> place(graph.block_begin.back(), kDropped);
  int num_kept = 0, num_eliminated = 0;
  for (const int b : kept) {
    is_kept[b] = true;
    for (int c = graph.block_begin[b]; c < graph.block_begin[b + 1]; ++c) place[c] = num_kept++;
  }
  for (size_t b = 0; b < blocks.size(); ++b) {
    if (is_kept[b]) continue;
    for (int c = graph.block_begin[b]; c < graph.block_begin[b + 1]; ++c) {
      if (blocks[b].IsHeld(c - graph.block_begin[b])) continue;
      place[c] = -2 - num_eliminated++;
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
  split.eliminated.resize(num_rows, num_eliminated);
  split.eliminated.setFromTriplets(to_eliminated.begin(), to_eliminated.end());
  return split;
}

/// An upper estimate of the smallest eigenvalue of a matrix with a diagonal of ones.
double SmallestEigenvalue(const Factorization& factorization) {
  constexpr int kSteps = 4;
  Eigen::VectorXd x(factorization.rows());
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    x[i] = 1 + 0.5 * std::sin(1.7 * static_cast<double>(i) + 0.3);
  }
  double inverse = 0;
  for (int k = 0; k < kSteps; ++k) {
    x = factorization.solve(x / x.norm());
    inverse = x.norm();
  }
  return 1 / inverse;
}

/// The smallest eigenvalue of the remaining matrix, with the earlier diagonal scaled to ones; its
/// smallest diagonal entry if eigenvalues would take too long.
double SmallestLeft(const RowMajor& left, const Eigen::VectorXd& diagonal) {
  constexpr Eigen::Index kMostOfEigenvalues = 300;
  const Eigen::VectorXd scale =
      diagonal.unaryExpr([](double value) { return value > 0 ? 1.0 / std::sqrt(value) : 1.0; });
  const Eigen::MatrixXd scaled = scale.asDiagonal() * left * scale.asDiagonal();
  if (scaled.rows() > kMostOfEigenvalues) return scaled.diagonal().minCoeff();
  return EigenvaluesOfSymmetric(scaled)[0];
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
  MarginalInformation result;
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
    result.is_certain = factorization.info() == Eigen::Success &&
                        factorization.vectorD().minCoeff() > SmallestPivot(m) &&
                        SmallestEigenvalue(factorization) > kLeastCertain;
    if (!result.is_certain) return result;
    // The kept columns and eta are solved together, with the same triangle.
    Eigen::MatrixXd sides(m, n + 1);
    sides.leftCols(n) = Eigen::MatrixXd(Sparse(scaled.transpose() * split.kept));
    sides.col(n) = -(scaled.transpose() * residual);
    sides = factorization.permutationP() * sides;
    factorization.matrixL().solveInPlace(sides);
    sides = factorization.vectorD().cwiseSqrt().cwiseInverse().asDiagonal() * sides;
    const Eigen::VectorXd diagonal = lambda.diagonal();
    lambda.noalias() -= sides.leftCols(n).transpose() * sides.leftCols(n);
    eta.noalias() -= sides.leftCols(n).transpose() * sides.col(n);
    result.is_certain = n == 0 || SmallestLeft(lambda, diagonal) > kLeastCertain;
  }
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
