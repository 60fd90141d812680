#pragma once

/// Supernodes of the Cholesky factor of S (derived in supernodes.cpp).

#include <cstdint>
#include <vector>

#include "core/linear/block_structure.h"

namespace bundle {

/// Columns of a panel that its updates process at a time. Such a slice is narrow, so that a product
/// is still in the cache when it is scattered.
constexpr int kColumnsOfSlice = 48;

/// The Cholesky factor of S as dense panels. A panel consists of consecutive block columns of L,
/// with the union of their block rows below. It is column-major. The diagonal blocks of its columns
/// come first; only their lower triangle is defined.
struct Supernodes {
  std::vector<int> first_block;       ///< num_panels + 1: block columns of each panel
  std::vector<int64_t> rows_begin;    ///< num_panels + 1: begin of each panel in `row_block`
  std::vector<int> row_block;         ///< block rows below a panel's own columns; ascending
  std::vector<int> row_in_panel;      ///< first row of each block row within its panel
  std::vector<int> height;            ///< rows of a panel, including those of its own columns
  std::vector<int64_t> values_begin;  ///< num_panels + 1
  double entries = 0;                 ///< nnz(L): lower triangle with the diagonal
  double zeros = 0;                   ///< explicit zeros that shared panels add

  int num_panels() const { return static_cast<int>(height.size()); }
};

/// `structure` is sparse and in the order of the elimination. Only consecutive columns can share a
/// panel, so the order should be an elimination tree's postorder.
Supernodes FindSupernodes(const BlockStructure& structure);

/// The panel of each block column.
std::vector<int> PanelOfBlocks(const Supernodes& supernodes);

/// The blocks of S, with the places of their values in the panels of the factor.
BlockStructure PlaceInFactor(const BlockStructure& structure, const Supernodes& supernodes);

}  // namespace bundle
