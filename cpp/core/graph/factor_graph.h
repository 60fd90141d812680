#pragma once

/// Factor graphs: least-squares problems of any structure, their validation, and the
/// marginalisation of variables.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/factors/factor.h"
#include "core/geometry/retraction.h"

namespace bundle {

struct FactorGraph {
  std::vector<Block> blocks;
  std::vector<std::unique_ptr<Factor>> factors;
};

/// Throws InputError, naming the variable, for a value that is not finite, a quaternion of norm 0,
/// flags that do not fit, or bounds that exclude the value.
void CheckBlock(const Block& block);

/// Throws InputError, naming factor and variable, if the factor's variables do not exist, are not
/// distinct, or are on another manifold than the factor expects.
void CheckVariables(const Factor& factor, const std::vector<Block>& blocks);

/// Evaluates the factor at the variables' values. Throws InputError, naming factor and variable,
/// for a residual or Jacobian without a finite value.
void CheckEvaluation(const Factor& factor, const std::vector<Block>& blocks);

/// Validates a graph, and evaluates every factor once at the variables' values. Throws InputError,
/// naming factor and variable:
///
/// - a factor of a variable that does not exist, of one twice, or of another manifold;
/// - a free variable without factors, or no factor at all;
/// - a value that is not finite, a quaternion of norm 0, bounds that exclude the value;
/// - a residual or Jacobian without a finite value.
void ValidateGraph(const FactorGraph& graph);

/// One pointer per variable of the factor.
std::vector<const double*> ValuesOf(const Factor& factor, const std::vector<Block>& blocks);

/// A graph linearised at its values: r(x + d) ~ r + J d over all tangent coordinates, free or
/// constant, the variables one after the other. With losses, r and J are the corrected ones.
struct LinearizedGraph {
  double cost = 0;  ///< 1/2 sum rho(||r||^2)
  std::vector<double> residual;
  std::vector<int> block_begin;    ///< first column of each variable, and the end
  std::vector<int64_t> row_begin;  ///< J by rows, compressed
  std::vector<int> columns;
  std::vector<double> values;
};

/// The information of a linearised graph on some of its variables.
///
/// The graph's cost is 1/2 d^T Lambda d - eta^T d + const with Lambda = J^T J and eta = -J^T r. Let
/// a be the eliminated and b the kept coordinates. Minimising over d_a leaves the Schur complement
///
///   Lambda' = Lambda_bb - Lambda_ba Lambda_aa^-1 Lambda_ab,
///   eta'    = eta_b - Lambda_ba Lambda_aa^-1 eta_a,
///
/// which takes one sparse factorisation, P (S Lambda_aa S) P^T = L D L^T, with S a diagonal matrix
/// that scales the diagonal of Lambda_aa to 1. With Y = D^(-1/2) L^-1 P S Lambda_ab and y likewise
/// from eta_a,
///
///   Lambda' = Lambda_bb - Y^T Y,        eta' = eta_b - Y^T y.
///
/// Lambda' is exactly symmetric. If the graph has no information along a direction of b, neither
/// has Lambda' (up to rounding).
struct MarginalInformation {
  std::vector<double> lambda;  ///< n x n, row-major, symmetric
  std::vector<double> eta;     ///< n
  /// False if the differences above leave too few digits. Lambda' may then be empty, or even
  /// indefinite; solver/marginal_by_root.h handles this case.
  bool is_certain = true;
};

/// Keeps the variables `kept`, in this order, and eliminates the free coordinates of all others.
/// Constant coordinates are not changed.
MarginalInformation MarginalizeOnto(const std::vector<int>& kept, const std::vector<Block>& blocks,
                                    const LinearizedGraph& graph);

}  // namespace bundle
