#pragma once

/// The eliminated part S_aa of a reduced camera system, factorised once. If it is singular, systems
/// are solved by a damped factor and iterative refinement (rest_information.h).

#include <memory>
#include <string>
#include <vector>

#include "core/covariance/reduced_system.h"
#include "core/linear/linear_solver.h"
#include "core/linear/symmetric_product.h"

namespace bundle {

/// Throws InputError if the memory cannot hold so many numbers.
void RefuseBeyondMemory(double numbers, const std::string& what);

class EliminatedPart {
 public:
  /// Keeps references to `whole` and to `diagonal`, the diagonal of J^T J.
  EliminatedPart(const ReducedSystem& whole, const std::vector<double>& diagonal);

  /// Uses the unknowns with `is_kept` zero. `place` becomes the index of each unknown in this part,
  /// or -1.
  void Take(const std::vector<uint8_t>& is_kept, std::vector<int>* place);

  int size() const { return num_unknowns_; }
  bool is_regular() const { return is_regular_; }

  /// Throws InputError if even a damped matrix cannot be factorised.
  void Factorize();

  /// X = S_aa^- B, size() x num_columns.
  void Solve(const std::vector<double>& b, int num_columns, std::vector<double>* x);

 private:
  /// S_aa plus a diagonal.
  void Fill(const std::vector<double>& added, BlockValues* values) const;
  double SmallestPivot() const;
  void SolveOnce(const std::vector<double>& b, int num_columns, std::vector<double>* x);
  /// Computes B - S_aa X. Returns the largest ratio of a column's norm to that of B, scaled.
  double Residual(const std::vector<double>& b, int num_columns, const std::vector<double>& x,
                  std::vector<double>* product, std::vector<double>* rest);

  const ReducedSystem& whole_;
  const std::vector<double>& diagonal_;
  const int threads_;
  int num_unknowns_ = 0;
  bool is_regular_ = true;
  std::vector<int> place_;  ///< per unknown of S: its index in this part; -1: it is kept
  std::vector<int> block_;  ///< per block of S: its index in structure_; -1: it is kept
  std::vector<double> own_diagonal_;
  BlockStructure structure_;
  std::unique_ptr<LinearSolver> solver_;
  std::unique_ptr<SymmetricProduct> product_;
  BlockSystem system_;
  BlockValues values_;  ///< S_aa, if the factor is that of a damped matrix
};

}  // namespace bundle
