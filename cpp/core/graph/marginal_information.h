#pragma once

/// The information that a linearised graph holds of some of its variables.
///
/// The graph's cost is 1/2 d^T Lambda d - eta^T d + const with Lambda = J^T J and eta = -J^T r. Let
/// a be what is eliminated and b what is kept. Minimising over d_a leaves the Schur complement
///
///   Lambda' = Lambda_bb - Lambda_ba Lambda_aa^-1 Lambda_ab,
///   eta'    = eta_b - Lambda_ba Lambda_aa^-1 eta_a,
///
/// for which one sparse factorisation serves, P (S Lambda_aa S) P^T = L D L^T with S a diagonal
/// that gives Lambda_aa a unit one: with Y = D^(-1/2) L^-1 P S Lambda_ab and y likewise of eta_a,
///
///   Lambda' = Lambda_bb - Y^T Y,        eta' = eta_b - Y^T y.
///
/// Lambda' is symmetric to the last bit. Where the graph says nothing of a direction of b, nor does
/// Lambda' (up to rounding).

#include <string>
#include <vector>

#include "core/graph/factor_graph.h"
#include "core/graph/linearized_graph.h"

namespace bundle {

struct MarginalInformation {
  std::vector<double> lambda;  ///< n x n, row-major, symmetric
  std::vector<double> eta;     ///< n
};

/// Keeps the variables `kept`, in this order, and eliminates the free coordinates of all others:
/// held ones stay where they are. Throws InputError, naming the variable, if what is to be
/// eliminated is not determined by its factors.
MarginalInformation MarginalizeOnto(const std::vector<int>& kept, const std::vector<Block>& blocks,
                                    const LinearizedGraph& graph);

}  // namespace bundle
