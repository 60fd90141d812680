#include "core/solver/solver.h"

/// The fused backend eliminates the points and factorises the reduced camera system, or solves it
/// iteratively. Ceres handles all other options and problems.

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/ceres/solve_with_ceres.h"
#include "core/error.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/factor_costs.h"
#include "core/model/fov_lenses.h"
#include "core/model/problem_factors.h"
#include "core/model/scene_frame.h"
#include "core/model/world_scale.h"
#include "core/parallel/blas.h"
#include "core/parallel/crew.h"
#include "core/prepare/memory.h"
#include "core/prepare/prepare.h"
#include "core/solver/fov_jump.h"
#include "core/solver/fused_solver.h"
#include "core/solver/fused_support.h"
#include "core/solver/newton_decrement.h"

namespace bundle {

namespace {

std::string SentenceOf(const Unsupported& obstacle) {
  return "The fused backend expects " + obstacle.expected + " and found " + obstacle.found + " (" +
         obstacle.option + ").";
}

}  // namespace

std::string ReasonForCeres(const SolveOptions& options) {
  if (options.backend == Backend::kFused) return "";
  if (options.backend == Backend::kCeres) return "Ceres was requested (backend).";
  const std::optional<Unsupported> obstacle = FindUnsupported(options);
  return obstacle ? SentenceOf(*obstacle) : "";
}

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
  return {Backend::kCeres, SentenceOf(*obstacle)};
}

namespace {

/// Ceres adds costs and products in an order that depends on its threads. Only with one thread are
/// the bits the same for any number of threads requested.
SolveOutput SolveWithCeresAsAsked(const AdjustmentProblem& problem, SolveOptions options,
                                  PreparedSolve prepared, const ProgressCallback& progress) {
  if (options.deterministic && options.num_threads != 1) {
    options.num_threads = 1;
    Warn(WarningKind::kSingleThread, "Ceres is deterministic on one thread only, so it used one.",
         &prepared.warnings);
  }
  const MeasureDecrement measure = [&options](const AdjustmentProblem& at) {
    return MeasureNewtonDecrement(at, options);
  };
  return SolveWithCeres(problem, options, std::move(prepared), progress, measure);
}

constexpr int64_t kNobody = 0;

/// At the start and at the solution, in the world of the factors.
void SetFactorCosts(const AdjustmentProblem& given, const ProblemFactors* factors,
                    SolveOutput* output) {
  if (factors == nullptr) return;
  AdjustmentProblem refined = given;
  refined.factors = factors;
  output->summary.num_factors = static_cast<int>(factors->factors.size());
  output->factor_costs_before = FactorCosts(refined);
  refined.cam_from_world = output->cam_from_world.data();
  refined.camera_params = output->camera_params.data();
  refined.points = output->points.data();
  output->PutShutters(&refined);
  output->factor_costs_after = FactorCosts(refined);
}

}  // namespace

/// A solver and the problem at its current values.
class Solver::Impl {
 public:
  Impl(const AdjustmentProblem& problem, const SolveOptions& options, bool is_reused)
      : problem_(problem), options_(options), is_reused_(is_reused) {
    RefuseTooLarge(problem);
    if (HasMemoryLimit()) TakeBlasBuffersAtFirstUse();
  }

  ~Impl() { AbandonAfterFork(); }

  /// Lays out everything for the current values.
  void PrepareFor(const AdjustmentProblem& given) {
    const ScaledProblem scaled(given);
    const CenteredProblem centered(scaled.view(), scaled.frame());
    TakeValues(centered.view());
    Prepare();
    if (fused_ == nullptr) prepared_.reset();  // solves by Ceres do their own preparation
  }

  void CheckStructure(const ProblemView& given) const { CheckSameStructure(problem_, given); }

  SolveOutput Solve(const AdjustmentProblem& given, const SolveOptions& given_options,
                    const ProgressCallback& progress) {
    const UseGuard guard(&user_);
    if (is_reused_) CheckStructure(given);
    SolveOptions options = options_;
    CopyChangeable(given_options, &options);
    const auto once = [this](const AdjustmentProblem& view, const SolveOptions& changed,
                             const ProgressCallback& report) {
      return SolveOnce(view, changed, report);
    };
    return SolveBeyondFovJump(given, FindFreeFovLenses(problem_, options_), options, progress,
                              once);
  }

 private:
  SolveOutput SolveOnce(const AdjustmentProblem& given, SolveOptions options,
                        const ProgressCallback& progress) {
    const Stopwatch time;
    AbandonAfterFork();
    if (!is_reused_) fused_.reset();
    const ScaledProblem scaled(given);
    const CenteredProblem centered(scaled.view(), scaled.frame());
    TakeValues(centered.view());
    if (!IsPreparedForValues()) Prepare();
    SceneFrame frame = centered.is_moved() ? SceneFrame(problem_) : scaled.frame();
    frame.unit = scaled.frame().unit;
    FarPoints far = FindFarPoints(problem_, layout(), frame);
    options.parameter_tolerance *= far.norm_without;
    std::vector<Warning> warnings = warnings_;
    Warn(WarningKind::kFarPoints, std::move(far.warning), &warnings);
    Warn(WarningKind::kWorldScale, scaled.warning(), &warnings);
    SolveOutput output = Run(options, std::move(warnings), progress);
    JudgeFarPoints(problem_, far, options, &output);
    centered.MoveBack(&output);
    scaled.ScaleBack(&output);
    SetFactorCosts(given, problem_.factors, &output);
    output.summary.backend_given = UpperName(options.backend, kBackends);
    output.summary.backend_used = UpperName(choice_.backend, kBackends);
    output.summary.backend_choice = choice_.reason;
    output.build_time_in_seconds = time.seconds() - output.solve_time_in_seconds;
    return output;
  }

  /// Allows one solve at a time.
  class UseGuard {
   public:
    explicit UseGuard(std::atomic<int64_t>* user) : user_(user) {
      // In a process that was forked during a solve, the parent is stored here.
      int64_t found = user->load();
      if (found == ProcessId() || !user->compare_exchange_strong(found, ProcessId())) {
        throw InputError(
            "Solver: expected one solve at a time, found another solve in progress; each thread "
            "needs its own solver");
      }
    }
    ~UseGuard() { user_->store(kNobody); }
    UseGuard(const UseGuard&) = delete;
    UseGuard& operator=(const UseGuard&) = delete;

   private:
    std::atomic<int64_t>* const user_;
  };

  /// Threads do not survive a fork: there are no threads to join.
  void AbandonAfterFork() {
    if (std::exchange(process_, ProcessId()) != ProcessId()) static_cast<void>(fused_.release());
  }

  void TakeValues(const AdjustmentProblem& from) {
    problem_.cam_from_world = from.cam_from_world;
    problem_.rig_from_world = from.rig_from_world;
    problem_.sensor_from_rig = from.sensor_from_rig;
    problem_.camera_params = from.camera_params;
    problem_.points = from.points;
    problem_.twists = from.twists;
    problem_.readouts = from.readouts;
    problem_.observation_xy = from.observation_xy;
    problem_.observation_sigma = from.observation_sigma;
    std::copy_n(from.origin, 3, problem_.origin);
  }

  const ParameterLayout& layout() const {
    return fused_ != nullptr ? fused_->layout() : prepared_->layout;
  }

  void Prepare() {
    fused_.reset();
    prepared_.emplace(PrepareSolve(problem_, options_));
    choice_ = ChooseBackend(options_, *prepared_);
    if (problem_.division.communicator != nullptr && choice_.backend != Backend::kFused) {
      throw InputError("backend: expected a solve by the fused backend with several processes. " +
                       (choice_.reason.empty() ? "Found ceres." : choice_.reason));
    }
    warnings_ = prepared_->warnings;
    if (choice_.backend != Backend::kFused) return;
    fused_ = std::make_unique<FusedSolver>(problem_, options_, std::move(*prepared_), is_reused_);
    prepared_.reset();
  }

  /// True if the layout fits the values. Free parameters depend on values only through the gauge.
  bool IsPreparedForValues() const {
    if (fused_ == nullptr) return false;
    if (options_.gauge == Gauge::kNone) return true;
    std::vector<Warning> same_warnings;  // warnings follow from the free parameters
    return ChooseFreeParameters(problem_, options_, &same_warnings) == fused_->layout().free();
  }

  SolveOutput Run(const SolveOptions& options, std::vector<Warning> warnings,
                  const ProgressCallback& progress) {
    if (fused_ != nullptr) return fused_->Solve(options, std::move(warnings), progress);
    PreparedSolve prepared = std::move(*prepared_);
    prepared_.reset();
    prepared.warnings = std::move(warnings);
    return SolveWithCeresAsAsked(problem_, options, std::move(prepared), progress);
  }

  /// Structure, bounds and factors of the constructor's problem, with the centred values of the
  /// last solve.
  AdjustmentProblem problem_;
  const SolveOptions options_;
  const bool is_reused_;
  std::optional<PreparedSolve> prepared_;  ///< for the next solve by Ceres
  BackendChoice choice_;
  std::vector<Warning> warnings_;       ///< warnings of PrepareSolve
  std::unique_ptr<FusedSolver> fused_;  ///< nullptr: not prepared, or solved by Ceres
  int64_t process_ = ProcessId();       ///< the process that has its threads
  std::atomic<int64_t> user_{kNobody};  ///< the process that currently solves
};

Solver::Solver(const AdjustmentProblem& problem, const SolveOptions& options)
    : impl_(std::make_unique<Impl>(problem, options, /*is_reused=*/true)) {
  impl_->PrepareFor(problem);
}

Solver::Solver(const AdjustmentProblem& problem, const SolveOptions& options, Once /*once*/)
    : impl_(std::make_unique<Impl>(problem, options, /*is_reused=*/false)) {}

Solver::~Solver() = default;

void Solver::CheckStructure(const ProblemView& problem) const { impl_->CheckStructure(problem); }

SolveOutput Solver::Solve(const AdjustmentProblem& problem, const SolveOptions& options,
                          const ProgressCallback& progress) {
  return impl_->Solve(problem, options, progress);
}

SolveOutput Solve(const AdjustmentProblem& problem, const SolveOptions& options,
                  const ProgressCallback& progress) {
  return Solver(problem, options, Solver::Once()).Solve(problem, options, progress);
}

}  // namespace bundle
