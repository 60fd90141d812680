#include "core/backend/solve.h"

#include <memory>
#include <utility>

#include "core/backend/choose_backend.h"
#include "core/blas_threads.h"
#include "core/ceres/losses.h"
#include "core/ceres/solve_with_ceres.h"
#include "core/fused/solve_with_fused.h"
#include "core/solve/memory.h"
#include "core/solve/option_names.h"
#include "core/solve/prepare.h"
#include "core/solve/scene_frame.h"
#include "core/solve/solver_checks.h"
#include "core/stopwatch.h"

namespace bundle {
namespace {

/// Ceres adds costs and products up in the order in which its threads come by: the same bits for
/// any number of threads are those of one.
SolveOutput SolveWithCeresAsAsked(const ProblemView& problem, SolveOptions options,
                                  PreparedSolve prepared, const ProgressCallback& progress) {
  if (options.deterministic && options.num_threads != 1) {
    options.num_threads = 1;
    Warn(WarningKind::kSingleThread,
         "Ceres is deterministic on one thread only, and so it got one.", &prepared.warnings);
  }
  return SolveWithCeres(problem, options, std::move(prepared), progress);
}

LossFunction MakeLossFunction(const SolveOptions& options) {
  return [loss = std::shared_ptr<ceres::LossFunction>(MakeLoss(options.loss, options.loss_scale))](
             double squared_norm) {
    double rho[3] = {squared_norm, 1, 0};
    if (loss) loss->Evaluate(squared_norm, rho);
    return std::make_pair(rho[0], rho[1]);
  };
}

}  // namespace

SolveOutput Solve(const ProblemView& given, const SolveOptions& given_options,
                  const ProgressCallback& progress) {
  const Stopwatch time;
  RefuseTooLarge(given);
  if (HasMemoryLimit()) TakeBlasBuffers();
  const SceneFrame given_frame(given);
  const CenteredProblem centered(given, given_frame);
  const ProblemView& problem = centered.view();
  SolveOptions options = given_options;
  PreparedSolve prepared = PrepareSolve(problem, options);
  FarPoints far = FindFarPoints(problem, prepared.layout,
                                centered.is_moved() ? SceneFrame(problem) : given_frame);
  options.parameter_tolerance *= far.norm_without;
  Warn(WarningKind::kFarPoints, std::move(far.warning), &prepared.warnings);
  BackendChoice choice = ChooseBackend(options, prepared);
  SolveOutput output = choice.backend == Backend::kFused
                           ? fused::SolveWithFused(problem, options, std::move(prepared), progress)
                           : SolveWithCeresAsAsked(problem, options, std::move(prepared), progress);
  JudgeFarPoints(problem, far, options, MakeLossFunction(options), &output);
  centered.MoveBack(&output);
  output.summary.backend_given = UpperName(options.backend, kBackends);
  output.summary.backend_used = UpperName(choice.backend, kBackends);
  output.summary.backend_choice = std::move(choice.reason);
  output.build_time_in_seconds = time.seconds() - output.solve_time_in_seconds;
  return output;
}

}  // namespace bundle
