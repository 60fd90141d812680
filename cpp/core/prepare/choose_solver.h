#pragma once

/// What `auto` means as a linear solver.

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

/// Chooses a linear solver of Ceres' for points eliminated first, by the shape of the problem.
SolverChoice ChooseCeresSolver(const ProblemView& problem, const ParameterLayout& layout,
                               const ProblemShape& shape);

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
LinearSolverCosts PredictLinearSolverCosts(const fused::BlockStructure& structure,
                                           const fused::FillOrdering& ordering, int num_threads);

/// Chooses a linear solver of the fused backend: the fastest of dense, sparse and iterative that
/// fits into the memory.
SolverChoice ChooseLinearSolver(const fused::BlockStructure& structure,
                                const fused::FillOrdering& ordering, int num_threads,
                                double available_bytes);

/// Values that the panels of the factor of S hold (supernodal_cholesky.h), zeros and all, when the
/// blocks are eliminated in this order. Any order will do; it is postordered first, as in a solve.
double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order);

/// What `auto` takes, on this machine and now. It does not ask below a few hundred columns.
SolverChoice ChooseByPattern(const BlockPatternView& pattern, int num_threads);

}  // namespace bundle
