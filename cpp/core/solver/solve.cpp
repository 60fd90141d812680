#include "core/solver/solve.h"

/// The fused backend does one thing: it eliminates the points and factorises or iterates on the
/// reduced camera system. Whatever else can be asked for is Ceres'.

#include <algorithm>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/ceres/solve_with_ceres.h"
#include "core/ceres/translate_options.h"
#include "core/error.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/scene_frame.h"
#include "core/parallel/blas.h"
#include "core/prepare/prepare.h"
#include "core/schur/elimination_plan.h"
#include "core/solver/solve_with_fused.h"

namespace bundle {

namespace {

/// An option that the fused backend does not take as it is.
struct Unsupported {
  std::string option;
  std::string expected;
  std::string found;
};

bool IsSupported(LinearSolverType type) {
  return type == LinearSolverType::kAuto || type == LinearSolverType::kDenseSchur ||
         type == LinearSolverType::kSparseSchur || type == LinearSolverType::kIterativeSchur;
}

bool IsSupported(PreconditionerType type) {
  return type != PreconditionerType::kClusterJacobi &&
         type != PreconditionerType::kClusterTridiagonal;
}

/// A preconditioner that no one reads is no obstacle.
bool MayIterate(LinearSolverType type) {
  return type == LinearSolverType::kAuto || type == LinearSolverType::kIterativeSchur;
}

std::optional<Unsupported> FindUnsupported(const SolveOptions& options,
                                           const PreparedSolve& prepared) {
  if (!IsSupported(options.linear_solver_type)) {
    return Unsupported{"linear_solver_type", "auto, dense_schur, sparse_schur or iterative_schur",
                       NameOf(options.linear_solver_type, kLinearSolverTypes)};
  }
  if (options.linear_solver_ordering != EliminationOrdering::kPointsFirst) {
    return Unsupported{"linear_solver_ordering", "points_first",
                       NameOf(options.linear_solver_ordering, kEliminationOrderings)};
  }
  if (MayIterate(options.linear_solver_type) && !IsSupported(options.preconditioner_type)) {
    return Unsupported{"preconditioner_type",
                       "identity, jacobi, schur_jacobi, schur_power_series_expansion or two_level",
                       NameOf(options.preconditioner_type, kPreconditionerTypes)};
  }
  const ParameterLayout& layout = prepared.layout;
  if (layout.num_free_points() == 0) {
    return Unsupported{"refine", "points, to eliminate them,", "none that is refined"};
  }
  if (layout.blocks().empty()) {
    return Unsupported{"refine", "poses or intrinsics beside the points", "none that are refined"};
  }
  const std::vector<int64_t>& lengths = prepared.track_lengths;
  const int64_t longest_track = *std::max_element(lengths.begin(), lengths.end());
  if (longest_track > fused::kMaxTrackLength) {
    return Unsupported{
        "backend", "at most " + std::to_string(fused::kMaxTrackLength) + " observations a point",
        "one with " + std::to_string(longest_track)};
  }
  return std::nullopt;
}

}  // namespace

BackendChoice ChooseBackend(const SolveOptions& options, const PreparedSolve& prepared) {
  if (options.backend == Backend::kCeres) return {Backend::kCeres, ""};
  const std::optional<Unsupported> obstacle = FindUnsupported(options, prepared);
  if (options.backend == Backend::kFused) {
    if (!obstacle) return {Backend::kFused, ""};
    throw InputError(obstacle->option + ": expected " + obstacle->expected +
                     " with the fused backend, found " + obstacle->found);
  }
  if (!obstacle) {
    return {Backend::kFused,
            "The points are eliminated as they are linearised, in one pass over the observations."};
  }
  return {Backend::kCeres, "The fused backend expects " + obstacle->expected + " and found " +
                               obstacle->found + " (" + obstacle->option + ")."};
}

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
