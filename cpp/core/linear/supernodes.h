#pragma once

/// Supernodes of the Cholesky factor of S (derived in supernodes.cpp).

#include <cstdint>
#include <vector>

#include "core/linear/block_structure.h"

namespace bundle {

/// The Cholesky factor of S as dense panels: consecutive block columns of L, with the block rows
/// that any of them has below. A panel is column-major; the diagonal blocks of its columns come
/// first, of which only the lower triangle is defined.
struct Supernodes {
  std::vector<int> first_block;       ///< num_panels + 1: block columns of each panel
  std::vector<int64_t> rows_begin;    ///< num_panels + 1: in `row_block`
  std::vector<int> row_block;         ///< below a panel's own columns; ascending
  std::vector<int> row_in_panel;      ///< first row of each of these within its panel
  std::vector<int> height;            ///< rows of a panel, its own columns' included
  std::vector<int64_t> values_begin;  ///< num_panels + 1
  double entries = 0;                 ///< nnz(L): lower triangle with the diagonal
  double zeros = 0;                   ///< explicit zeros that shared panels add

  int num_panels() const { return static_cast<int>(height.size()); }
};

/// `structure` is a sparse one in the order of the elimination. Columns can share a panel only
/// where they follow each other: the order should be an elimination tree's postorder.
Supernodes FindSupernodes(const BlockStructure& structure);

/// The blocks of S, each where its values are within the panels of the factor.
BlockStructure PlaceInFactor(const BlockStructure& structure, const Supernodes& supernodes);

}  // namespace bundle
