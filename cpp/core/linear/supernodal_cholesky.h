#pragma once

#include <cstdint>
#include <vector>

#include "core/linear/supernodes.h"

namespace bundle {

/// S = L L^T in place, in the panels of the factor.
class SupernodalCholesky {
 public:
  /// `offset` as in BlockStructure.
  SupernodalCholesky(std::vector<int> offset, Supernodes supernodes);

  /// `values` is S in the layout of PlaceInFactor, zero outside of its blocks, and becomes L.
  /// Returns 0, or the order of a leading minor that is not positive definite; `values` are then
  /// undefined.
  int Factorize(double* values);

  /// X = S^-1 X with the values of Factorize; num_columns x num_rhs, column-major. A single
  /// right-hand side is solved by vector operations, several by matrix products; their rounding
  /// differs.
  void Solve(const double* values, double* x, int num_rhs = 1);

  /// Replaces the values of the factor by those of S^-1 at the same places (selected_inverse.cpp).
  /// Both triangles of the panels' diagonal blocks are filled.
  void Invert(double* values);

 private:
  /// Rows that are consecutive in a panel and in the panel that it updates.
  struct RowRange {
    int source, target, length;
  };

  int FirstColumn(int panel) const { return offset_[supernodes_.first_block[panel]]; }
  int Width(int panel) const { return FirstColumn(panel + 1) - FirstColumn(panel); }
  int BlockSize(int64_t row) const;
  void LocateRows(int panel);
  void QueueUpdate(int panel, int64_t first_row);
  void Update(int panel, int by, double* values);
  void UpdateColumns(int panel, int by, int64_t first_row, int64_t last_row, double* values);
  void FindRowRanges(int by, int64_t first_row);
  void SolveOne(const double* values, double* x);
  void InvertPanel(int panel, double* values);
  void CopyStrip(const double* values, int by, int64_t first, int64_t last, int64_t end, int rows,
                 std::vector<double>* strip);
  void SolveMany(const double* values, double* x, int num_rhs);

  const std::vector<int> offset_;
  const Supernodes supernodes_;
  std::vector<int> panel_of_;      ///< panel per block column
  std::vector<int> position_;      ///< per block row: its position in the panel that is updated
  std::vector<int> first_update_;  ///< per panel: the first panel waiting to update it; -1: none
  std::vector<int> next_update_;   ///< per panel: the next panel in its queue; -1: none
  std::vector<int64_t>
      next_row_;  ///< per panel: its first row that is not yet added to another panel
  std::vector<RowRange> row_ranges_;
  std::vector<double> product_;
};

}  // namespace bundle
