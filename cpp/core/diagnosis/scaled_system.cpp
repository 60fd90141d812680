#include "core/diagnosis/scaled_system.h"

/// An unknown is undetermined in two cases. Either its largest meaningful change moves no pixel by
/// kInvisible, or motions of points can compensate it completely: S_jj = U_jj - w_j^T V^-1 w_j = 0.
/// In the second case, the elimination leaves rounding errors of the size of U_jj, which scaling
/// would amplify. So the unknown counts as undetermined if S_jj is less than kAbsorbed U_jj. The
/// rows of undetermined unknowns are removed from the system.
///
/// For all other unknowns, the elimination leaves rounding errors of e U_jj, e = 2^-53, times a few
/// dozen for the sums. This is e U_jj / S_jj in units of the unknown. So values of z^T S z up to
/// about
///
///   kRounding e sum_j z_j^2 U_jj / S_jj
///
/// are not meaningful. This matters for long scenes: if the origin is far away, motions of points
/// compensate a rotation of an image almost completely.

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

namespace bundle {
namespace {

constexpr double kUnitRoundoff = 0.5 * std::numeric_limits<double>::epsilon();
constexpr double kAbsorbed = 1e-12;
constexpr double kInvisible = 1e-6;
constexpr double kRounding = 100;

void AddSquares(const ObservationRows& rows, const BlockStructure& structure,
                std::vector<double>* squares) {
  for (int b = 0; b < rows.num_blocks; ++b) {
    const int size = rows.size[b];
    double* const to = &(*squares)[structure.offset[rows.block[b]]];
    for (int k = 0; k < 2 * size; ++k) to[k % size] += rows.jacobian[b][k] * rows.jacobian[b][k];
  }
}

}  // namespace

std::vector<double> SquaredColumns(const ReducedSystem& reduced) {
  const size_t size = reduced.num_unknowns();
  std::vector<std::vector<double>> of_thread(reduced.num_threads(), std::vector<double>(size, 0.0));
  reduced.ForPoints([&](int, const PointBlocks&, const PointAssembler& point, int thread) {
    for (int i = 0; i < point.num_rows(); ++i) {
      AddSquares(point.row(i), reduced.structure(), &of_thread[thread]);
    }
  });
  std::vector<double> squares(size, 0.0);
  reduced.ForObservationsOfFixedPoints(
      [&](const ObservationRows& rows) { AddSquares(rows, reduced.structure(), &squares); });
  for (const std::vector<double>& sum : of_thread) {
    for (size_t j = 0; j < size; ++j) squares[j] += sum[j];
  }
  return squares;
}

ScaledSystem::ScaledSystem(ReducedSystem* reduced, const std::vector<double>& squares,
                           const std::vector<double>& units)
    : reduced_(reduced),
      compact_(CompactStructure(reduced->structure())),
      scale_(reduced->num_unknowns(), 0.0),
      rounding_(Eigen::VectorXd::Zero(reduced->num_unknowns())),
      values_(compact_.num_values, 0.0),
      product_(compact_, reduced->num_threads()) {
  if (size() == 0) return;
  AddBlocks(reduced->structure(), reduced->values().data(), compact_, values_.data());
  const std::vector<double>& diagonal = reduced_->diagonal();
  for (int j = 0; j < size(); ++j) {
    const double root = std::sqrt(std::max(diagonal[j], 0.0));
    const bool is_seen = diagonal[j] > kAbsorbed * squares[j] && root * units[j] > kInvisible;
    if (!is_seen) continue;
    scale_[j] = 1 / root;
    rounding_[j] = kRounding * kUnitRoundoff * squares[j] / diagonal[j];
  }
  Scale();
}

void ScaledSystem::Scale() {
  const BlockStructure& structure = compact_;
  for (int j = 0; j < structure.num_blocks(); ++j) {
    for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
      const int i = structure.row_block[e];
      for (int c = 0; c < structure.block_size(j); ++c) {
        const int column = structure.offset[j] + c;
        double* const values = &values_[structure.ValueIndex(j, e, 0, c)];
        for (int r = 0; r < structure.block_size(i); ++r) {
          const int row = structure.offset[i] + r;
          values[r] = row == column ? 1.0 : values[r] * scale_[row] * scale_[column];
        }
      }
    }
  }
}

Eigen::MatrixXd ScaledSystem::Multiply(const Eigen::MatrixXd& x) {
  Eigen::MatrixXd y(x.rows(), x.cols());
  for (Eigen::Index k = 0; k < x.cols(); ++k) {
    product_.Multiply(values_, x.col(k).data(), y.col(k).data());
  }
  return y;
}

int ScaledSystem::Factorize(double shift) {
  BlockValues& values = reduced_->values();
  const BlockStructure& structure = reduced_->structure();
  std::fill(values.begin(), values.end(), 0.0);
  AddBlocks(compact_, values_.data(), structure, values.data());
  structure.ForDiagonal([&](int, int64_t at) { values[at] += shift; });
  const LinearSolution solution = reduced_->Factorize();
  if (solution.status == LinearStatus::kSuccess) return -1;
  return std::max(solution.failed_minor - 1, 0);
}

Eigen::MatrixXd ScaledSystem::Solve(const Eigen::MatrixXd& x) {
  Eigen::MatrixXd y(x.rows(), x.cols());
  const LinearSolution solution = reduced_->Solve(x.data(), static_cast<int>(x.cols()), y.data());
  if (solution.status != LinearStatus::kSuccess) throw std::runtime_error(solution.message);
  return y;
}

}  // namespace bundle
