#pragma once

/// Memory of a solve: predicted, available, and refused before any work is done.

#include <cstdint>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/interface/options.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// Bytes of the dense matrices that a solver allocates: the Jacobian, the normal equations or the
/// Schur complement, by where the method keeps them. 0 for the solvers without a dense matrix.
/// `solver` is the one that really runs, after fallbacks.
double PredictDenseMatrixBytes(LinearSolverType solver, const ProblemShape& shape,
                               bool cameras_eliminated);

/// Bytes of memory that this process may still take: the least of what the machine has, what the
/// control groups of the process leave (versions 1 and 2, with pages of files that can be dropped)
/// and what the limits on address space and data segment leave (ulimit -v and -d). A huge number
/// where nothing of that can be told. `root` stands before the paths in /proc and /sys.
double AvailableMemoryBytes(const std::string& root = "");

/// AvailableMemoryBytes(), or a huge number where no more than `bytes` are needed and they are few:
/// asking the system takes a tenth of a millisecond, a tenth of a small problem's solve.
double AvailableMemoryFor(double bytes);

/// True if the address space or the data segment of this process has a limit.
bool HasMemoryLimit();

/// Bytes of what the fused backend keeps beside S or its factor: the sorted observations, the
/// numbers of their pairs, two states with what belongs to each, and chunk buffers of
/// `num_threads` threads of at most `buffer_bytes`. `has_sigmas`: observations have them.
double PredictFusedWorkingBytes(const ParameterLayout& layout,
                                const std::vector<int64_t>& track_lengths, bool has_sigmas,
                                int num_threads, double buffer_bytes);

/// Bytes of Ceres' objects for observations and points, and of the Jacobian, as measured
/// (bundle/inspection/peak_memory.py).
double PredictCeresWorkingBytes(const ProblemShape& shape);

/// "1.4 GB": powers of 1000 and three digits, as python/bundle/memory_sizes.py writes them.
std::string FormatBytes(double bytes);

/// Error: a solve would need more memory than is available.
class NotEnoughMemoryError : public InputError {
 public:
  using InputError::InputError;
};

/// True if `bytes` leave a tenth of the available memory to everything else.
bool FitsIntoMemory(double bytes, double available);

/// Throws NotEnoughMemoryError if the dense matrices of a solver do not fit into the free memory.
void RefuseTooMuchMemory(LinearSolverType type, const ProblemShape& shape, bool cameras_eliminated);

/// Throws if matrices of a number of bytes do not fit. `what`: their name; `instead`: the solver to
/// use.
void RefuseTooMuchMemory(LinearSolverType type, double bytes, const char* what,
                         const char* instead);

/// Throws if a factor does not fit, beside the bytes of observations and points.
void RefuseTooMuchMemory(LinearSolverType type, double factor_bytes, double working_bytes = 0);

/// Throws if the observations and points do not fit, whatever the solver of a backend.
void RefuseTooMuchMemory(double working_bytes);

}  // namespace bundle
