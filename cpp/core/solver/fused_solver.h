#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/minimize/trust_region.h"
#include "core/model/parameter_layout.h"
#include "core/prepare/prepare.h"
#include "core/schur/schur_problem.h"

namespace bundle {

/// Wall times in seconds.
struct SolveTimes {
  double preprocessor = 0;
  double minimizer = 0;
  double postprocessor = 0;
  double total = 0;
};

/// Bundle adjustment by the fused backend, for one structure: the constructor chooses the linear
/// solver, orders, analyses and plans; each Solve starts at the values that the problem then has.
class FusedSolver {
 public:
  /// `prepared` is what PrepareSolve made of the problem; options and layout are such that
  /// ChooseBackend takes them. Keeps a reference to the problem, whose values (poses, camera
  /// parameters, points, measurements) may change between solves. `is_reused`: for more than one
  /// Solve; otherwise the first frees S before it collects the result.
  ///
  /// Throws InputError if options exclude each other or the dense matrices of the solver would not
  /// fit into memory.
  FusedSolver(const AdjustmentProblem& problem, const SolveOptions& options, PreparedSolve prepared,
              bool is_reused);

  /// `options` may differ from the constructor's in what Solver::Solve says; anything else in them
  /// has no effect. The summary's warnings are `warnings` and those of the choices made before.
  /// Whatever keeps the solve from converging is in the summary.
  SolveOutput Solve(const SolveOptions& options, std::vector<Warning> warnings,
                    const ProgressCallback& progress);

  const ParameterLayout& layout() const { return layout_; }

 private:
  void ChooseSolver();
  double BufferBytes() const;
  void ChooseBySize(const ProblemShape& shape);
  std::vector<int> BlockSizes() const;
  void FindSparseStructure();
  FillOrdering FindOrdering() const;
  void BuildProblem();
  double NumSystemValues() const;
  void SummarizeFactor();
  std::unique_ptr<LinearSolver> MakeSolver();
  /// True if it has converged and may take further iterations.
  bool MayGoOn(const MinimizerSummary& minimum) const;
  ProgressCallback AddFixedCost(const ProgressCallback& progress) const;
  void CollectState(SolveOutput* output);
  int64_t CountInformation();

  const AdjustmentProblem& problem_;
  SolveOptions options_;  ///< with nothing left to choose
  const bool is_reused_;
  std::vector<Warning> warnings_;  ///< of the choices
  std::string linear_solver_choice_;
  ParameterLayout layout_;
  std::vector<int64_t> track_lengths_;  ///< until the memory is predicted
  BlockStructure structure_;            ///< until the problem has it
  FillOrdering ordering_;               ///< of the sparse structure
  double working_bytes_ = 0;            ///< beside the system
  std::unique_ptr<LinearSolver> solver_;
  std::unique_ptr<SchurProblem> schur_;
  FactorSummary factor_;
  double symbolic_time_ = 0;  ///< of finding the structure, its ordering and the solver's panels
  double build_time_ = 0;     ///< of the constructor, where a solve is to report it
  int64_t num_information_nonzeros_ = -1;  ///< -1: not counted yet
};

/// A minimum as ceres::Solver::Summary tells it. `options` has nothing left to choose.
///
/// Three of Ceres' times name other work here, because linearisation and elimination are one pass:
/// the Jacobian evaluation includes the elimination of the points, the linear solver's time is that
/// of the reduced camera system alone, and the residual evaluation includes the back-substitution.
SolveSummary Summarize(const SolveOptions& options, const ParameterLayout& layout,
                       const SchurProblem& schur, const MinimizerSummary& minimum,
                       const SolveTimes& times);

/// Whose costs the final cost is the least of: all steps, as Ceres has it, or the accepted ones.
/// Where steps change what counts, costs of different steps are sums over different observations,
/// and the final cost is that of the last accepted one.
enum class Counted { kAll, kAccepted };

/// What our own solvers report alike: of the options, of the minimum (which leaves out the constant
/// `fixed_cost`), and sizes, of which nothing is constant.
void SummarizeChoices(const SolveOptions& options, SolveSummary* result);
void SummarizeMinimum(const MinimizerSummary& minimum, double fixed_cost, Counted counted,
                      SolveSummary* result);
void SetSizes(int num_blocks, int num_parameters, int64_t num_residual_blocks,
              int64_t num_residuals, SolveSummary* result);

/// `structure` as its solver wants it, with that solver's statistics.
FactorSummary SummarizeFactor(const BlockStructure& structure, const FactorStatistics& statistics,
                              double symbolic_time_in_seconds);

/// One sentence if the factor takes far more than its ordering predicted; else "".
std::string FindSwollenFactor(const FactorStatistics& statistics);

}  // namespace bundle
