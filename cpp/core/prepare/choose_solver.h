#pragma once

/// Choice of a linear solver by its predicted cost (derived in choose_solver.cpp).

#include <string>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/linear/fill_ordering.h"
#include "core/model/parameter_layout.h"
#include "core/symbolic/block_pattern.h"

namespace bundle {

struct SolverChoice {
  LinearSolverType type = LinearSolverType::kDenseSchur;
  std::string reason;              ///< one sentence
  bool leaves_out_system = false;  ///< true if conjugate gradients do not form S
};

/// Chooses a linear solver of Ceres by the shape of the problem and the group that is eliminated
/// first.
SolverChoice ChooseCeresSolver(const AdjustmentProblem& problem, const ParameterLayout& layout,
                               const ProblemShape& shape, bool cameras_eliminated = false);

/// Predicted cost of one solve of a reduced camera system.
struct LinearSolverCost {
  double flops = 0;
  double bytes = 0;  ///< memory of the system and its solver
  double seconds = 0;
};

struct LinearSolverCosts {
  LinearSolverCost dense;
  LinearSolverCost sparse;
  LinearSolverCost iterative;
  LinearSolverCost implicit;   ///< conjugate gradients without S; infinite if it is not possible
  double forming_seconds = 0;  ///< time that the other three need to form S
};

/// `structure` is sparse; `ordering` is the order of its factorisation. `num_observations`: 0 if S
/// must be formed. `num_pairs`: sum over the points of the pairs of their observations.
LinearSolverCosts PredictLinearSolverCosts(const BlockStructure& structure,
                                           const FillOrdering& ordering, int num_threads,
                                           int64_t num_observations = 0, int64_t num_pairs = 0);

/// True if conjugate gradients can work without S, and S does not fit into memory or makes them
/// clearly slower.
bool LeavesOutSystem(const LinearSolverCosts& costs, double available_bytes);

/// Chooses a linear solver of the fused backend: the fastest of dense, sparse and iterative, with
/// or without S, that fits into the memory.
SolverChoice ChooseLinearSolver(const BlockStructure& structure, const FillOrdering& ordering,
                                int num_threads, double available_bytes,
                                int64_t num_observations = 0, int64_t num_pairs = 0);

/// Number of values in the panels of the factor of S (supernodal_cholesky.h), including zeros, if
/// the blocks are eliminated in this order. Accepts any order; it is postordered first, as in a
/// solve.
double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order);

/// The choice of `auto` on this machine, with the memory available now. Does not query the memory
/// for fewer than a few hundred columns.
SolverChoice ChooseByPattern(const BlockPatternView& pattern, int num_threads,
                             int64_t num_observations, int64_t num_pairs);

}  // namespace bundle
