#pragma once

#include <string>
#include <vector>

#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/model/parameter_layout.h"
#include "core/symbolic/symbolic.h"

namespace bundle {

struct SolverChoice {
  LinearSolverType type = LinearSolverType::kDenseSchur;
  std::string reason;  ///< one sentence
};

/// Chooses a linear solver for points eliminated first.
SolverChoice ChooseLinearSolver(const ProblemView& problem, const ParameterLayout& layout,
                                const ProblemShape& shape);

}  // namespace bundle

namespace bundle::fused {

/// What one solve of a reduced camera system is expected to cost.
struct LinearSolverCost {
  double flops = 0;
  double bytes = 0;  ///< of memory: the system itself and what its solver keeps
  double seconds = 0;
};

struct LinearSolverCosts {
  LinearSolverCost dense;
  LinearSolverCost sparse;
  LinearSolverCost iterative;
};

/// `structure` is a sparse one, `ordering` the one that it would be factorised in.
LinearSolverCosts PredictLinearSolverCosts(const BlockStructure& structure,
                                           const FillOrdering& ordering, int num_threads);

struct LinearSolverChoice {
  LinearSolverType type = LinearSolverType::kDenseSchur;
  std::string reason;  ///< one sentence
};

/// The fastest of dense, sparse and iterative that fits into the memory.
LinearSolverChoice ChooseLinearSolver(const BlockStructure& structure, const FillOrdering& ordering,
                                      int num_threads, double available_bytes);

/// What the solvers of this folder would make of a pattern of S, for those who only ask.

/// Values that the panels of the factor of S hold (supernodal_cholesky.h), zeros and all, when the
/// blocks are eliminated in this order. Any order will do; it is postordered first, as the solver
/// does.
double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order);

/// What `auto` takes, on this machine and now. It does not ask below a few hundred columns.
LinearSolverChoice ChooseByPattern(const BlockPatternView& pattern, int num_threads);

}  // namespace bundle::fused
