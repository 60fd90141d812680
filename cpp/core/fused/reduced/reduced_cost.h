#pragma once

#include <string>

#include "core/fused/reduced/fill_ordering.h"
#include "core/fused/reduced/reduced_system.h"
#include "core/solve/options.h"

namespace bundle::fused {

/// What one solve of a reduced camera system is expected to cost.
struct ReducedCost {
  double flops = 0;
  double bytes = 0;  ///< of memory: the system itself and what its solver keeps
  double seconds = 0;
};

struct ReducedCosts {
  ReducedCost dense;
  ReducedCost sparse;
  ReducedCost iterative;
};

/// `structure` is a sparse one, `ordering` the one that it would be factorised in.
ReducedCosts PredictReducedCosts(const ReducedStructure& structure, const FillOrdering& ordering,
                                 int num_threads);

struct ReducedChoice {
  LinearSolverType type = LinearSolverType::kDenseSchur;
  std::string reason;  ///< one sentence
};

/// The fastest of dense, sparse and iterative that fits into the memory.
ReducedChoice ChooseReducedSolver(const ReducedStructure& structure, const FillOrdering& ordering,
                                  int num_threads, double available_bytes);

}  // namespace bundle::fused
