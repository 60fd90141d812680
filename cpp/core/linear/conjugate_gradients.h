#pragma once

/// Preconditioned conjugate gradients (derived in conjugate_gradients.cpp).

#include <memory>

#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"

namespace bundle {

/// Preconditioned conjugate gradients, as Ceres' ITERATIVE_SCHUR runs them; takes a sparse
/// structure. `preconditioner` is one of kIdentity, kJacobi, kSchurJacobi,
/// kSchurPowerSeriesExpansion and kTwoLevel; `is_implicit`: one of the first three, and products
/// with S come from LinearSolver::SetProduct.
std::unique_ptr<LinearSolver> MakeIterativeSolver(const BlockStructure& structure,
                                                  PreconditionerType preconditioner,
                                                  int num_threads, bool is_implicit = false);

}  // namespace bundle
