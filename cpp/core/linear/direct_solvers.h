#pragma once

/// Direct solvers of the reduced camera system.

#include <memory>

#include "core/linear/block_structure.h"
#include "core/linear/fill_ordering.h"
#include "core/linear/linear_solver.h"

namespace bundle {

/// LAPACK's Cholesky factorisation; takes a dense structure.
/// `same_bits`: for any number of threads (tiled_cholesky.h).
std::unique_ptr<LinearSolver> MakeDenseSolver(const BlockStructure& structure, int num_threads,
                                              bool same_bits = false);

/// A supernodal Cholesky factorisation, analysed once. `structure` is a sparse one whose blocks
/// stand in the order of the elimination, which `ordering` counted; it then says where the solver
/// wants their values, in place of its factor.
std::unique_ptr<LinearSolver> MakeSparseSolver(const FillOrdering& ordering, int num_threads,
                                               BlockStructure* structure);

/// Stands for the solver of rank 0 on other ranks, which get its steps (schur/schur_problem.cpp):
/// it solves nothing. The arguments are properties of the solver of rank 0.
std::unique_ptr<LinearSolver> MakeRemoteSolver(bool needs_camera_diagonal, bool is_iterative);

}  // namespace bundle
