#pragma once

/// Variables and factors: a least-squares problem of any structure.

#include <memory>
#include <vector>

#include "core/factors/factor.h"
#include "core/model/block.h"

namespace bundle {

struct FactorGraph {
  std::vector<Block> blocks;
  std::vector<std::unique_ptr<Factor>> factors;
};

/// Throws InputError, naming the variable, for a value that is not finite, a quaternion of norm 0,
/// flags that do not fit, or bounds that exclude the value.
void CheckBlock(const Block& block);

/// Throws InputError, naming factor and variable, if the factor's variables do not exist, are not
/// different, or are of another manifold than it takes them for.
void CheckVariables(const Factor& factor, const std::vector<Block>& blocks);

/// Checks what Python's FactorGraph and any other maker of graphs must get right, and evaluates
/// every factor once at the variables' values. Throws InputError, naming factor and variable:
///
/// - a factor of a variable that does not exist, of one twice, or of another manifold;
/// - a free variable without factors, or no factor at all;
/// - a value that is not finite, a quaternion of norm 0, bounds that exclude the value;
/// - a residual or Jacobian without a finite value.
void ValidateGraph(const FactorGraph& graph);

/// One pointer a variable of the factor.
std::vector<const double*> ValuesOf(const Factor& factor, const std::vector<Block>& blocks);

}  // namespace bundle
