#pragma once

/// Order of the elimination of S, chosen by the cost of its Cholesky factor.

#include <string>
#include <vector>

#include "core/linear/block_structure.h"

namespace bundle {

/// Order of the elimination of the blocks of S, and the cost of its Cholesky factor.
struct FillOrdering {
  std::string name;  ///< "natural", "amd", "metis" or "minimum_fill"
  std::vector<int>
      order;  ///< order[k]: the block eliminated as number k; a postorder of the elimination tree
  double entries = 0;  ///< nnz(L)
  double flops = 0;    ///< multiplications and additions; n^3 / 3 if S fills in completely
  double elimination_flops = 0;  ///< FactorCounts::flops, for reports
};

/// The cheapest of three orderings: natural, AMD and METIS.
FillOrdering FindFillOrdering(const BlockStructure& structure);

/// `known`, or minimum fill if that has fewer flops and is found in milliseconds. For the S of
/// images, which consists of overlapping cliques: the images of each point.
FillOrdering TryMinimumFill(const BlockStructure& structure, FillOrdering known);

/// Ordering by one method: "natural", "amd", "metis" or another of symbolic/orderings.h.
FillOrdering FindFillOrdering(const BlockStructure& structure, const std::string& method);

}  // namespace bundle
