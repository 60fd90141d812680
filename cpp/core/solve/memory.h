#pragma once

#include <cstdint>
#include <string>

#include "core/solve/options.h"
#include "core/solve/problem_shape.h"

namespace bundle {

/// Bytes of the dense matrices that a solver allocates: the Jacobian, the normal equations or the
/// Schur complement, by where the method keeps them. 0 for the solvers without a dense matrix.
/// `solver` is the one that really runs, after fallbacks.
double PredictDenseMatrixBytes(LinearSolverType solver, const ProblemShape& shape,
                               bool cameras_eliminated);

/// Bytes of memory that a process may still take before the machine runs out; a huge number where
/// that cannot be told.
double AvailableMemoryBytes();

/// "1.4 GB": powers of 1000 and three digits, as python/bundle/memory_sizes.py writes them.
std::string FormatBytes(double bytes);

}  // namespace bundle
