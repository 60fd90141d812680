#include "core/covariance/long_sums.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cstddef>

#include "core/covariance/eliminated_rows.h"
#include "core/dense/decompositions.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;

/// Products of a column of a matrix with `kColumns` following ones, in long doubles. The processor
/// loads doubles faster than long doubles, and several sums hide the time of an addition.
template <int kColumns>
void MultiplyColumns(const double* x, const double* columns, Eigen::Index num_rows,
                     long double* products) {
  long double sums[kColumns] = {};
  for (Eigen::Index row = 0; row < num_rows; ++row) {
    const long double factor = x[row];
    for (int k = 0; k < kColumns; ++k) sums[k] += factor * columns[k * num_rows + row];
  }
  std::copy_n(sums, kColumns, products);
}

/// Adds rows^T rows of these unknowns to the lower triangle.
void AddSquares(const std::vector<int>& unknowns, const MatrixXd& rows, LongMatrix* sum) {
  constexpr int kAtOnce = 4;
  for (Eigen::Index a = 0; a < rows.cols(); ++a) {
    const double* const x = rows.col(a).data();
    for (Eigen::Index first = 0; first <= a; first += kAtOnce) {
      const auto count = static_cast<int>(std::min<Eigen::Index>(kAtOnce, a + 1 - first));
      const double* const columns = rows.col(first).data();
      long double products[kAtOnce];
      if (count == kAtOnce) {
        MultiplyColumns<kAtOnce>(x, columns, rows.rows(), products);
      } else {
        for (int k = 0; k < count; ++k) {
          MultiplyColumns<1>(x, columns + k * rows.rows(), rows.rows(), products + k);
        }
      }
      for (int k = 0; k < count; ++k) {
        const int i = unknowns[a], j = unknowns[first + k];
        (*sum)(std::max(i, j), std::min(i, j)) += products[k];
      }
    }
  }
}

void AppendUnknowns(const ParameterLayout& layout, int block, std::vector<int>* unknowns) {
  for (int k = 0; k < layout.blocks()[block].size; ++k) {
    unknowns->push_back(layout.blocks()[block].offset + k);
  }
}

/// Rows of an observation of a constant point, multiplied by `left`.
void AddObservation(const ParameterLayout& layout, const ObservationRows& of, const MatrixXd& left,
                    LongMatrix* sum) {
  std::vector<int> unknowns;
  for (int b = 0; b < of.num_blocks; ++b) AppendUnknowns(layout, of.block[b], &unknowns);
  MatrixXd rows(left.rows(), static_cast<Eigen::Index>(unknowns.size()));
  for (int b = 0, first = 0; b < of.num_blocks; first += of.size[b++]) {
    rows.middleCols(first, of.size[b]) = Multiply(left, RowsByBlock(of, b));
  }
  AddSquares(unknowns, rows, sum);
}

/// The rows of a point include its own factors.
void AddFactors(const ReducedSystem& system, LongMatrix* sum) {
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  system.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    if (!rows.points.empty()) return;
    const auto size = static_cast<Eigen::Index>(rows.unknowns.size());
    AddSquares(rows.unknowns, Eigen::Map<const RowMajor>(rows.jacobian.data(), rows.num_rows, size),
               sum);
  });
}

/// Mirrors the lower triangle. Rows of unknowns held on bounds become zero, with `own` on the
/// diagonal.
void Finish(const ReducedSystem& system, long double own, LongMatrix* sum) {
  const Eigen::Index n = sum->rows();
  for (Eigen::Index j = 0; j < n; ++j) {
    for (Eigen::Index i = j + 1; i < n; ++i) (*sum)(j, i) = (*sum)(i, j);
  }
  for (size_t u = 0; u < system.held().size(); ++u) {
    if (system.held()[u] == 0) continue;
    const auto j = static_cast<Eigen::Index>(u);
    sum->row(j).setZero();
    sum->col(j).setZero();
    (*sum)(j, j) = own;
  }
}

}  // namespace

std::vector<int> UnknownsOf(const ParameterLayout& layout, const PointBlocks& blocks) {
  std::vector<int> unknowns;
  for (const int block : blocks.blocks) AppendUnknowns(layout, block, &unknowns);
  return unknowns;
}

MatrixXd FindReducedShares(const ReducedSystem& system, int point, const PointBlocks& blocks,
                           const PointAssembler& rows) {
  const MatrixXd all = AllRows(
      blocks, rows, system.point_prior_rows(point),
      [](const ObservationRows& of) { return Eigen::RowVector2d(of.score[0], of.score[1]); });
  const Eigen::Map<const MatrixXd> y(blocks.y.data(), 3, blocks.begin.back());
  return all.rightCols(y.cols()) - Multiply(all.leftCols(3), y);
}

LongMatrix SumSystemOfRows(const ReducedSystem& system) {
  LongMatrix sum = LongMatrix::Zero(system.num_unknowns(), system.num_unknowns());
  system.ForPoints(1, [&](int point, const PointBlocks& blocks, const PointAssembler& of, int) {
    const EliminatedRows rows(blocks, of, system.point_prior_rows(point));
    AddSquares(UnknownsOf(system.layout(), blocks), rows.rest(), &sum);
  });
  system.ForObservationsOfFixedPoints([&](const ObservationRows& rows) {
    AddObservation(system.layout(), rows, MatrixXd::Identity(2, 2), &sum);
  });
  AddFactors(system, &sum);
  Finish(system, 1, &sum);
  return sum;
}

LongMatrix SumMeatOfRows(const ReducedSystem& system) {
  LongMatrix sum = LongMatrix::Zero(system.num_unknowns(), system.num_unknowns());
  system.ForPoints(1, [&](int point, const PointBlocks& blocks, const PointAssembler& of, int) {
    AddSquares(UnknownsOf(system.layout(), blocks), FindReducedShares(system, point, blocks, of),
               &sum);
  });
  system.ForObservationsOfFixedPoints([&](const ObservationRows& rows) {
    AddObservation(system.layout(), rows, Eigen::Map<const Eigen::RowVector2d>(rows.score), &sum);
  });
  AddFactors(system, &sum);
  Finish(system, 0, &sum);
  return sum;
}

std::optional<LongMatrix> LongCholesky(const LongMatrix& s) {
  const Eigen::LLT<LongMatrix> factor(s);
  if (factor.info() != Eigen::Success) return std::nullopt;
  return LongMatrix(factor.matrixL());
}

void SolveLong(const LongMatrix& lower, LongMatrix* b) {
  lower.triangularView<Eigen::Lower>().solveInPlace(*b);
  lower.triangularView<Eigen::Lower>().transpose().solveInPlace(*b);
}

}  // namespace bundle
