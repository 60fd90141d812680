#pragma once

/// Memory of a solve: prediction, available memory, and errors before any work is done.

#include <cstdint>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/interface/options.h"
#include "core/model/parameter_layout.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// Bytes of the dense matrices that a solver allocates, by method: the Jacobian, the normal
/// equations or the Schur complement. 0 for the solvers without a dense matrix. `solver` is the
/// solver that actually runs, after fallbacks.
double PredictDenseMatrixBytes(LinearSolverType solver, const ProblemShape& shape,
                               bool cameras_eliminated);

/// Bytes of memory that this process may still allocate. This is the minimum of the machine's free
/// memory, of the rest of its control groups (versions 1 and 2, including file pages that can be
/// dropped), and of the rest of the limits on address space and data segment (ulimit -v and -d). A
/// huge number if all of them are unknown. `root` is a prefix of the paths in /proc and /sys.
double AvailableMemoryBytes(const std::string& root = "");

/// AvailableMemoryBytes(), or a huge number if `bytes` is small. The query takes 0.1 ms, a tenth of
/// the solve of a small problem.
double AvailableMemoryFor(double bytes);

/// True if the address space or the data segment of this process has a limit.
bool HasMemoryLimit();

/// Bytes of the fused backend in addition to S or its factor: the sorted observations, the numbers
/// of their pairs, two states with their records, and chunk buffers of `num_threads` threads with
/// at most `buffer_bytes` each. `has_sigmas`: observations have them. `has_pairs`: S is formed, so
/// pairs are listed.
double PredictFusedWorkingBytes(const ParameterLayout& layout,
                                const LargeVector<int64_t>& track_lengths, bool has_sigmas,
                                bool has_pairs, int num_threads, double buffer_bytes);

/// Bytes of Ceres' objects for observations and points, and of the Jacobian, as measured
/// (python/bundle/planning/inspection/peak_memory.py).
double PredictCeresWorkingBytes(const ProblemShape& shape);

/// "1.4 GB": powers of 1000 and three digits, as python/bundle/base/words.py writes them.
std::string FormatBytes(double bytes);

/// Error of a solve that would need more memory than is available.
class NotEnoughMemoryError : public InputError {
 public:
  using InputError::InputError;
};

/// True if `bytes` leaves a tenth of the available memory free.
bool FitsIntoMemory(double bytes, double available);

/// Throws NotEnoughMemoryError if the dense matrices of a solver do not fit into the free memory.
void RefuseTooMuchMemory(LinearSolverType type, const ProblemShape& shape, bool cameras_eliminated);

/// Throws if matrices with this number of bytes do not fit. `what`: their name; `instead`: the
/// recommended solver.
void RefuseTooMuchMemory(LinearSolverType type, double bytes, const char* what,
                         const char* instead);

/// Throws if a factor does not fit in addition to the bytes of observations and points.
void RefuseTooMuchMemory(LinearSolverType type, double factor_bytes, double working_bytes = 0);

/// Throws if the observations and points do not fit, for any solver of a backend.
void RefuseTooMuchMemory(double working_bytes);

}  // namespace bundle
