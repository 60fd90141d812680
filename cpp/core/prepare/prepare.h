#pragma once

/// From a problem and options to a layout and a linear solver (choose_solver.cpp), or a refusal
/// before any work is done: options that exclude each other, and memory, predicted and available
/// (memory.cpp).

#include <cstdint>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/model/parameter_layout.h"
#include "core/symbolic/symbolic.h"

namespace bundle {

/// What every backend starts from.
struct PreparedSolve {
  ParameterLayout layout;
  std::vector<Warning> warnings;
  std::vector<int64_t> track_lengths;  ///< observations of each point
  int64_t num_free_points = 0;         ///< on all ranks
  int64_t longest_track = 0;           ///< on all ranks
  /// The first factor that couples a point with something else, or that only Ceres evaluates, and
  /// what is special about it; "": there is none.
  std::string factor_for_ceres;
};

/// What the options leave free and the gauge does not hold; the values of the problem matter to the
/// gauge alone. Warns where the gauge could not be held as asked, or need not be.
FreeParameters ChooseFreeParameters(const AdjustmentProblem& problem, const SolveOptions& options,
                                    std::vector<Warning>* warnings);

/// Decides what is free and how it is laid out. The problem is valid (problem_view.h).
///
/// Throws InputError if a camera model is not supported or an id to be fixed does not exist.
PreparedSolve PrepareSolve(const AdjustmentProblem& problem, const SolveOptions& options);

/// True for the solvers that have a preconditioner and no exact steps.
bool IsIterative(LinearSolverType type);

/// Throws InputError if the trust region needs exact steps and the linear solver, which is not
/// kAuto, has none.
void CheckTrustRegion(const SolveOptions& options);

/// One sentence if a preconditioner was asked for that the linear solver has no use for; else "".
std::string FindIdlePreconditioner(const SolveOptions& options);

/// One sentence if an elimination ordering was asked for of a linear solver that has none; else "".
std::string FindIdleOrdering(const SolveOptions& options);

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

/// A solve that needs more memory than there is, said before it begins.
class NotEnoughMemoryError : public InputError {
 public:
  using InputError::InputError;
};

/// True if `bytes` leave a tenth of the available memory to everything else.
bool FitsIntoMemory(double bytes, double available);

/// Throws NotEnoughMemoryError if the dense matrices of a solver do not fit into the free memory.
void RefuseTooMuchMemory(LinearSolverType type, const ProblemShape& shape, bool cameras_eliminated);

/// The same for matrices of so many bytes: `what` they are, and which solver to use `instead`.
void RefuseTooMuchMemory(LinearSolverType type, double bytes, const char* what,
                         const char* instead);

/// The same for a solver whose matrix takes so many bytes, beside those of observations and points.
void RefuseTooMuchMemory(LinearSolverType type, double factor_bytes, double working_bytes = 0);

/// The same for what any solver of a backend keeps of the observations and points.
void RefuseTooMuchMemory(double working_bytes);

/// Throws InputError if there are more residuals or parameters than an int counts: Ceres numbers
/// them so, and so do the reports of both backends.
void RefuseTooLarge(const ProblemView& problem);

struct SolverChoice {
  LinearSolverType type = LinearSolverType::kDenseSchur;
  std::string reason;  ///< one sentence
};

/// Chooses a linear solver of Ceres', by the shape of the problem and what is eliminated first.
SolverChoice ChooseCeresSolver(const AdjustmentProblem& problem, const ParameterLayout& layout,
                               const ProblemShape& shape, bool cameras_eliminated = false);

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

/// Chooses a linear solver of the fused backend: the fastest of dense, sparse and iterative that
/// fits into the memory.
SolverChoice ChooseLinearSolver(const BlockStructure& structure, const FillOrdering& ordering,
                                int num_threads, double available_bytes);

/// Values that the panels of the factor of S hold (supernodal_cholesky.h), zeros and all, when the
/// blocks are eliminated in this order. Any order will do; it is postordered first, as in a solve.
double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order);

/// What `auto` takes, on this machine and now. It does not ask below a few hundred columns.
SolverChoice ChooseByPattern(const BlockPatternView& pattern, int num_threads);

}  // namespace bundle
