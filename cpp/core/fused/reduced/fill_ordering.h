#pragma once

#include <string>
#include <vector>

#include "core/fused/reduced/reduced_system.h"

namespace bundle::fused {

/// An order in which to eliminate the blocks of S, and what its Cholesky factor then costs.
struct FillOrdering {
  std::string name;        ///< "natural", "amd" or "metis"
  std::vector<int> order;  ///< order[k]: the block eliminated as the k-th; an etree's postorder
  double entries = 0;      ///< of the factor
  double flops = 0;        ///< multiplications and additions; n^3 / 3 where S fills up
  double elimination_flops = 0;  ///< FactorCounts::flops, which reports speak of
};

/// The cheapest of the natural order, AMD's and METIS'.
FillOrdering FindFillOrdering(const ReducedStructure& structure);

}  // namespace bundle::fused
