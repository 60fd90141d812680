#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/linear/block_structure.h"
#include "core/linear/fill_ordering.h"
#include "core/linear/linear_solver.h"
#include "core/minimize/trust_region.h"
#include "core/model/parameter_layout.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/prepare.h"
#include "core/schur/schur_problem.h"
#include "core/scratch/large_vector.h"
#include "core/solver/summarize_fused.h"

namespace bundle {

/// Bundle adjustment by the fused backend, for one structure. The constructor chooses the linear
/// solver, orders, analyses and plans. Each Solve starts at the current values of the problem.
class FusedSolver {
 public:
  /// `prepared` is the output of PrepareSolve for the problem; ChooseBackend must accept options
  /// and layout. Keeps a reference to the problem, whose values (poses, camera parameters, points,
  /// measurements) may change between solves. `is_reused`: Solve will be called more than once;
  /// otherwise the first Solve frees S before it collects the result.
  ///
  /// Throws InputError if options exclude each other or the dense matrices of the solver would not
  /// fit into memory.
  FusedSolver(const AdjustmentProblem& problem, const SolveOptions& options, PreparedSolve prepared,
              bool is_reused);

  /// `options` may differ from the constructor's as in Solver::Solve; other differences have no
  /// effect. The summary's warnings are `warnings` and those of earlier choices. The summary has
  /// the reason if the solve does not converge.
  SolveOutput Solve(const SolveOptions& options, std::vector<Warning> warnings,
                    const ProgressCallback& progress);

  const ParameterLayout& layout() const { return layout_; }

  /// The Newton decrements at the problem's values; NaN with an iterative linear solver.
  NewtonDecrement Decrement();

 private:
  void ChooseSolver();
  double BufferBytes() const;
  void ChooseBySize(const ProblemShape& shape);
  std::string ReasonForSystem() const;
  int64_t NumObservationsWithoutSystem() const;
  int64_t NumPairs() const;
  void ChooseSystem();
  void FindSparseStructure();
  void BroadcastOrdering();
  void TryMinimumFill();
  void BuildProblem();
  double NumSystemValues() const;
  void SummarizeFactor();
  std::unique_ptr<LinearSolver> MakeSolver();
  /// True if the solve has converged and may take further iterations.
  bool MayGoOn(const MinimizerSummary& minimum) const;
  ProgressCallback AddFixedCost(const ProgressCallback& progress) const;
  void CollectState(SolveOutput* output);
  int64_t CountInformation();

  const AdjustmentProblem& problem_;
  SolveOptions options_;  ///< without kAuto
  const bool is_reused_;
  std::vector<Warning> warnings_;  ///< warnings of the choices
  std::string linear_solver_choice_;
  bool is_implicit_ = false;  ///< conjugate gradients without S
  ParameterLayout layout_;
  LargeVector<int64_t> track_lengths_;  ///< freed once the memory is predicted
  BlockStructure structure_;            ///< moved to the problem
  FillOrdering ordering_;               ///< ordering of the sparse structure
  double working_bytes_ = 0;            ///< bytes in addition to the system
  std::unique_ptr<ThreadPool> pool_;    ///< threads of the passes and of direct solvers
  std::unique_ptr<LinearSolver> solver_;
  std::unique_ptr<SchurProblem> schur_;
  FactorSummary factor_;
  double symbolic_time_ = 0;  ///< time of structure, ordering and supernodes
  double build_time_ = 0;     ///< time of the constructor, if the next solve reports it
  int64_t num_information_nonzeros_ = -1;  ///< -1: not counted yet
};

}  // namespace bundle
