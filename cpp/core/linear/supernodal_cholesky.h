#pragma once

#include <cstdint>
#include <vector>

#include "core/linear/kernels/panel_kernels.h"
#include "core/linear/panel_subtrees.h"
#include "core/linear/supernodes.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

/// Supernodal Cholesky factorisation: S = L L^T in place, in the panels of the factor.
class SupernodalCholesky {
 public:
  /// `offset` as in BlockStructure.
  SupernodalCholesky(std::vector<int> offset, Supernodes supernodes);

  /// `values` is S in the layout of PlaceInFactor, zero outside of its blocks, and becomes L.
  /// Returns 0, or the order of a leading minor that is not positive definite; `values` are then
  /// undefined. The bits do not depend on the number of threads. nullptr: this thread alone.
  int Factorize(double* values, ThreadPool* pool = nullptr);

  /// X = S^-1 X with the values of Factorize; num_columns x num_rhs, column-major. A single
  /// right-hand side is solved by vector operations, several by matrix products; their rounding
  /// differs (supernodal_solve.cpp).
  void Solve(const double* values, double* x, int num_rhs = 1);

  /// Replaces the values of the factor by those of S^-1 at the same places (selected_inverse.cpp).
  /// Both triangles of the panels' diagonal blocks are filled.
  void Invert(double* values);

 private:
  /// Memory of a thread.
  struct Scratch {
    std::vector<int> position;     ///< per block row: its position in the panel that is updated
    std::vector<RowRange> ranges;  ///< the rows of an update
    std::vector<double> product;
    int64_t work = 0;  ///< since the last look for an interruption
  };

  int FirstColumn(int panel) const { return offset_[supernodes_.first_block[panel]]; }
  int Width(int panel) const { return FirstColumn(panel + 1) - FirstColumn(panel); }
  int BlockSize(int64_t row) const;
  int FactorizeSubtree(int subtree, double* values, Scratch* scratch);
  int FactorizePanel(int panel, double* values, ThreadPool* pool, Scratch* scratch);
  template <typename Queue>
  void PassOn(int panel, const Queue& queue);
  void QueueUpdate(int panel, int64_t first_row);
  int64_t RowFrom(int panel, int64_t row, int block) const;
  void LocateRows(int panel, std::vector<int>* position) const;
  void UpdateColumns(int panel, int first_block, int last_block, double* values,
                     const std::vector<int>& position, Scratch* scratch) const;
  void Update(int panel, int by, int64_t first_row, int64_t last_row, double* values,
              const std::vector<int>& position, Scratch* scratch) const;
  void FindRowRanges(int by, int64_t first_row, const std::vector<int>& position,
                     std::vector<RowRange>* ranges) const;
  void SolveOne(const double* values, double* x);
  void SolveMany(const double* values, double* x, int num_rhs);
  void InvertPanel(int panel, double* values);
  void CopyStrip(const double* values, int by, int64_t first, int64_t last, int64_t end, int rows,
                 std::vector<double>* strip);

  const std::vector<int> offset_;
  const Supernodes supernodes_;
  const PanelKernels& kernels_ = SelectPanelKernels();
  std::vector<int> panel_of_;  ///< panel per block column
  PanelSubtrees subtrees_;
  std::vector<int> first_update_;  ///< per panel: the first panel waiting to update it; -1: none
  std::vector<int> next_update_;   ///< per panel: the next panel in its queue; -1: none
  std::vector<int64_t>
      next_row_;  ///< per panel: its first row that is not yet added to another panel
  std::vector<std::vector<int>> leaving_;  ///< per subtree: panels whose next update is of the top
  std::vector<Scratch> scratch_;           ///< per thread
};

}  // namespace bundle
