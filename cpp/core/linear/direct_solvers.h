#pragma once

/// Direct solvers of the reduced camera system.

#include <memory>

#include "core/linear/block_structure.h"
#include "core/linear/fill_ordering.h"
#include "core/linear/linear_solver.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

/// Cholesky factorisation; requires a dense structure. `same_bits`: the bits do not depend on the
/// number of threads. With our own kernels (tiled_cholesky.h) they never do. `pool` as below.
std::unique_ptr<LinearSolver> MakeDenseSolver(const BlockStructure& structure, int num_threads,
                                              bool same_bits = false, ThreadPool* pool = nullptr);

/// A sparse factorisation of fewer flops, less than a millisecond, does not start threads.
inline constexpr double kFlopsWorthThreads = 5e7;

/// Supernodal Cholesky factorisation, analysed once. `structure` is sparse, with blocks in the
/// order of the elimination, as in `ordering`. On return `structure` has the places of its
/// values in the factor. `pool`: threads that the caller has, which must outlive the solver;
/// nullptr: the solver starts its own if the factorisation takes long. The bits of a factor do not
/// depend on the number of threads.
std::unique_ptr<LinearSolver> MakeSparseSolver(const FillOrdering& ordering, int num_threads,
                                               BlockStructure* structure,
                                               ThreadPool* pool = nullptr);

/// Placeholder on all ranks but rank 0. They receive the steps of rank 0 (schur/schur_problem.cpp),
/// and this class solves no system. The arguments are properties of the solver of rank 0.
std::unique_ptr<LinearSolver> MakeRemoteSolver(bool needs_camera_diagonal, bool is_iterative);

}  // namespace bundle
