#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "support/normal_equations.h"

namespace bundle {

/// Keeps the system that it is to solve, and solves it in extended precision.
class CapturingSolver final : public LinearSolver {
 public:
  explicit CapturingSolver(BlockStructure structure) : structure_(std::move(structure)) {}

  bool NeedsCameraDiagonal() const override { return true; }

  const std::vector<double>& scale() const { return scale_; }

  oracle::RealMatrix matrix, camera_diagonal;
  oracle::RealVector rhs;

 private:
  LinearSolution DoFactorize(BlockSystem* system, const std::vector<double>& scale) override {
    const int n = num_columns();
    scale_ = scale;
    matrix = oracle::RealMatrix::Zero(n, n);
    camera_diagonal = oracle::RealMatrix::Zero(n, n);
    rhs.resize(n);
    for (int i = 0; i < n; ++i) rhs[i] = system->rhs[i];
    int64_t diagonal_at = 0;
    for (int j = 0; j < structure_.num_blocks(); ++j) {
      const int columns = structure_.block_size(j), left = structure_.offset[j];
      for (int64_t e = structure_.column_begin[j]; e < structure_.column_begin[j + 1]; ++e) {
        const int block = structure_.row_block[e], top = structure_.offset[block];
        for (int r = 0; r < structure_.block_size(block); ++r) {
          for (int c = 0; c < columns; ++c) {
            if (top + r < left + c) continue;  // only the lower triangle means anything
            const double value = system->values[structure_.ValueIndex(j, e, r, c)];
            matrix(top + r, left + c) = matrix(left + c, top + r) = value;
          }
        }
      }
      for (int c = 0; c < columns; ++c) {
        for (int r = 0; r < columns; ++r) {
          camera_diagonal(left + r, left + c) = system->camera_diagonal.at(diagonal_at++);
        }
      }
    }
    return {};
  }

  LinearSolution DoSolve(const double* /*rhs*/, int /*num_rhs*/, double /*eta*/,
                         double* x) override {
    const int n = num_columns();
    const oracle::RealVector solution =
        n > 0 ? oracle::RealVector(oracle::SolveSymmetric(matrix, rhs)) : oracle::RealVector();
    for (int i = 0; i < n; ++i) x[i] = static_cast<double>(solution[i]);
    return {};
  }

  int num_columns() const { return structure_.num_blocks() == 0 ? 0 : structure_.num_columns(); }

  const BlockStructure structure_;
  std::vector<double> scale_;
};

}  // namespace bundle
