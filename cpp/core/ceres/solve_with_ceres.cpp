#include "core/ceres/solve_with_ceres.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <limits>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "core/ceres/ceres_solve.h"
#include "core/ceres/losses.h"
#include "core/ceres/translate_options.h"
#include "core/ceres/untaken_decrease.h"
#include "core/checking/check_solution.h"
#include "core/checking/lost_observations.h"
#include "core/model/coupled_blocks.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/choose_solver.h"
#include "core/prepare/memory.h"

namespace bundle {
namespace {

constexpr double kNotKnown = std::numeric_limits<double>::quiet_NaN();

}  // namespace

struct CeresSolve::Refined : AdjustmentProblem {
  Refined(const AdjustmentProblem& problem, const CameraStates& states, const double* all_points)
      : AdjustmentProblem(problem),
        poses(states.CamFromWorld()),
        frames(states.RigFromWorld()),
        sensors(states.SensorFromRig()),
        motions(states.Twists()) {
    cam_from_world = poses.data();
    if (!frames.empty()) rig_from_world = frames.data();
    if (!sensors.empty()) sensor_from_rig = sensors.data();
    camera_params = states.camera_params().data();
    points = all_points;
    if (motions.empty()) return;
    twists = motions.data();
    readouts = states.readouts().data();
  }
  Refined(const Refined&) = delete;
  Refined& operator=(const Refined&) = delete;

  const std::vector<double> poses, frames, sensors, motions;
};

CeresSolve::CeresSolve(const AdjustmentProblem& problem, const SolveOptions& options,
                       PreparedSolve prepared, const MeasureDecrement& measure)
    : measure_(measure),
      problem_(problem),
      options_(options),
      warnings_(std::move(prepared.warnings)),
      layout_(std::move(prepared.layout)),
      track_lengths_(std::move(prepared.track_lengths)),
      states_(problem, layout_),
      num_coordinates_(3 * static_cast<int64_t>(problem.num_points)),
      numbers_(StartNumbers(problem, layout_)),
      update_states_(State(), &states_, &watch_, &active_bounds_, &lengths_, &abandonment_),
      context_{problem_, layout_, states_, options.cheirality, &watch_, &abandonment_.happened},
      loss_(MakeLoss(options.loss, options.loss_scale)) {
  watch_.loss = options.loss;
  watch_.loss_scale = options.loss_scale;
}

SolveOutput CeresSolve::Run(const ProgressCallback& progress) {
  RefuseTooMuchMemory(PredictCeresWorkingBytes(
      ShapeOf(layout_, 2 * static_cast<int64_t>(problem_.num_observations))));
  BuildProblem();
  ThrowIfInterrupted();
  ceres::Solver::Options ceres_options = ChooseSolver();
  // Without this limit, Ceres would not start if the system cannot create more threads.
  ceres_options.num_threads = UseOneThread() ? 1 : CountStartableThreads(ceres_options.num_threads);
  ThrowIfInterrupted();
  lengths_.Add(numbers_.data(), numbers_.size());
  const ProcessSettings settings(BlasThreads(ceres_options));
  const Stopwatch solve_time;
  SolveOutput output;
  ceres::Solver::Summary summary = SolveOnce(progress, ceres_options, &output);
  while (const std::optional<Continuation> next = FindContinuation(summary)) {
    const ceres::Solver::Summary first = std::move(summary);
    summary = SolveOnce(progress, OptionsToGoOn(ceres_options, first, *next), &output, *next);
    PutBefore(first, next->repeats, &summary);
  }
  output.solve_time_in_seconds = solve_time.seconds();
  const bool interrupted = output.summary.interrupted;
  output.summary = Summarize(summary, fixed_cost_);
  output.summary.interrupted = interrupted;
  output.summary.untaken_decrease = UntakenDecrease(summary, ceres_problem_.get());
  output.summary.distance_in_sigmas = distance_;
  output.summary.largest_camera_step_in_sigmas = camera_distance_;
  Collect(summary, &output);
  return output;
}

ceres::Solver::Summary CeresSolve::SolveOnce(const ProgressCallback& progress,
                                             ceres::Solver::Options ceres_options,
                                             SolveOutput* output,
                                             const Continuation& continuation) {
  const bool repeats = continuation.repeats;
  const ProgressCallback complete = [&](const IterationRecord& iteration) {
    if (repeats && iteration.iteration == 0) return true;  // repeats the last iteration
    IterationRecord record = iteration;
    record_holding_.CompleteCurrent(&record);
    return !progress || progress(record);
  };
  ReportProgress report(complete, fixed_cost_, lengths_, abandonment_.happened);
  RememberAnchors remember_anchors(states_);
  RememberBest best(numbers_, states_, watch_);
  const bool in_sigmas = options_.convergence == ConvergenceRule::kSigmas;
  const bool settles = !factor_costs_.empty() && ceres_options.function_tolerance > kTightTolerance;
  EndInSigmas end(in_sigmas ? DegreesOfFreedom() : 0, in_sigmas && !settles,
                  ceres_options.function_tolerance, watch_, record_holding_,
                  [this] { return Decrement(); });
  ceres_options.callbacks = {&remember_anchors, &record_holding_, &lengths_, &best, &report, &end};
  if (end.takes_last_step()) {
    ceres_options.function_tolerance = std::min(ceres_options.function_tolerance, kLostChange);
  }
  update_states_.BeginSolve(/*all_count=*/!repeats);
  record_holding_.BeginSolve(repeats);
  lengths_.BeginSolve();
  ceres::Solver::Summary summary;
  ceres::Solve(ceres_options, ceres_problem_.get(), &summary);
  if (!end.message().empty() && summary.termination_type == ceres::USER_SUCCESS) {
    summary.termination_type = ceres::CONVERGENCE;
    summary.message = end.message();
  }
  states_.SetAnchors(remember_anchors.AtEnd(summary));
  if (!factor_costs_.empty() && EndedByTolerance(summary)) {
    Settle(std::move(ceres_options), &report, &best, &end, &summary);
  }
  abandonment_.exception.Rethrow();
  if (abandonment_.happened) ForgetAbandonedStep(&summary);
  for (ceres::IterationSummary& iteration : summary.iterations) {
    iteration.step_norm = lengths_.Of(iteration);
  }
  output->summary.interrupted = report.interrupted() || abandonment_.happened;
  states_.Update(State());
  record_holding_.EndSolve(summary.iterations.size());
  share_ = continuation.share;
  TellOfCostWithoutHeld(&summary);
  if (summary.termination_type == ceres::CONVERGENCE) {
    end.MeasureEnd(summary.final_cost - watch_.state_cost);
  }
  const bool has_converged = summary.termination_type == ceres::CONVERGENCE;
  distance_ = has_converged ? end.distance() : kNotKnown;
  camera_distance_ = has_converged ? end.camera_distance() : kNotKnown;
  ReturnToBest(best, summary);
  return summary;
}

void CeresSolve::TellOfCostWithoutHeld(ceres::Solver::Summary* summary) const {
  constexpr char kFormat[] = "Function tolerance reached. |cost_change|/cost: %le <= %le";
  double share = 0, tolerance = 0;
  const bool is_ours = share_ == 1 && options_.convergence != ConvergenceRule::kSigmas;
  if (is_ours || std::sscanf(summary->message.c_str(), kFormat, &share, &tolerance) != 2) {
    return;
  }
  std::array<char, 128> text;
  std::snprintf(text.data(), text.size(),
                "Function tolerance reached. |cost_change|/cost: %e <= %e", share / share_,
                options_.function_tolerance);
  summary->message = text.data();
}

std::optional<Continuation> CeresSolve::FindContinuation(
    const ceres::Solver::Summary& summary) const {
  const int64_t num_held = watch_.num_held.load();
  if (num_held == 0 || summary.termination_type != ceres::CONVERGENCE) return std::nullopt;
  if (summary.iterations.back().iteration >= options_.max_num_iterations) return std::nullopt;
  const auto last = std::find_if(
      summary.iterations.rbegin(), summary.iterations.rend(),
      [](const ceres::IterationSummary& iteration) { return iteration.step_is_successful; });
  const double share = std::max(0.0, 1 - watch_.state_cost.load() / last->cost);
  const bool by_function = options_.convergence != ConvergenceRule::kSigmas &&
                           summary.message.rfind("Function tolerance", 0) == 0;
  // A change in the last digits of the held cost is no reason to repeat.
  constexpr double kSameShare = 1e-3;
  if (by_function && share < (1 - kSameShare) * share_) return Continuation{true, share};
  if (!LeavesOut(Refined(problem_, states_, numbers_.data()))) return std::nullopt;
  return Continuation{};
}

bool CeresSolve::LeavesOut(const AdjustmentProblem& refined) const {
  const int64_t num_held = watch_.num_held.load();
  return num_held > 0 && CountLeftOut(refined, layout_, options_, num_held) > 0;
}

NewtonDecrement CeresSolve::Decrement() const {
  if (!measure_ || IsIterative(options_.linear_solver_type)) return {};
  const Refined refined(problem_, states_, numbers_.data());
  return LeavesOut(refined) ? NewtonDecrement() : measure_(refined);
}

void CeresSolve::ReturnToBest(const RememberBest& best, const ceres::Solver::Summary& summary) {
  const bool ended_early = summary.termination_type == ceres::NO_CONVERGENCE ||
                           summary.termination_type == ceres::USER_SUCCESS;
  if (!ended_early || !best.IsEarlier()) return;
  std::copy(best.numbers().begin(), best.numbers().end(), numbers_.begin());
  states_.SetAnchors(best.anchors());
  states_.Update(State());
  watch_.state_cost = best.held_cost();
  watch_.num_held = best.num_held();
  best_cost_ = best.cost();
}

double CeresSolve::DegreesOfFreedom() const {
  if (options_.loss != LossType::kTrivial) return 0;
  int64_t degrees = num_residuals_ - layout_.state_size();
  for (int i = 0; i < problem_.num_points; ++i) {
    if (layout_.point_is_free(i)) degrees -= std::min<int64_t>(3, 2 * track_lengths_[i]);
  }
  return static_cast<double>(degrees);
}

ceres::Solver::Options CeresSolve::OptionsToGoOn(ceres::Solver::Options result,
                                                 const ceres::Solver::Summary& summary,
                                                 const Continuation& next) {
  const ceres::IterationSummary& last = summary.iterations.back();
  result.max_num_iterations -= last.iteration + (next.repeats ? 0 : 1);
  result.function_tolerance *= next.share;
  if (next.repeats) result.initial_trust_region_radius = last.trust_region_radius;
  result.linear_solver_ordering =
      MakeOrdering(options_.linear_solver_ordering, problem_, layout_, numbers_.data(), State());
  return result;
}

void CeresSolve::Settle(ceres::Solver::Options options, ReportProgress* report, RememberBest* best,
                        EndInSigmas* end, ceres::Solver::Summary* summary) {
  update_states_.BeginSolve(/*all_count=*/false);
  lengths_.Restart();
  RememberAnchors remember_anchors(states_);
  options.linear_solver_ordering =
      MakeOrdering(options_.linear_solver_ordering, problem_, layout_, numbers_.data(), State());
  const auto anchors = states_.anchors();
  const MayEnd may_end = [&](const ceres::IterationSummary& iteration, bool meets_tolerance) {
    const bool in_sigmas = options_.convergence == ConvergenceRule::kSigmas;
    return in_sigmas ? end->MayEnd(iteration, meets_tolerance) : meets_tolerance;
  };
  const bool went_on = SettleFactors(factor_costs_, std::move(options),
                                     {&remember_anchors, &record_holding_, &lengths_, best, report},
                                     may_end, ceres_problem_.get(), summary);
  states_.SetAnchors(went_on ? remember_anchors.AtEnd(*summary) : anchors);
}

bool CeresSolve::UseOneThread() {
  if (problem_.factors == nullptr || options_.num_threads == 1) return false;
  for (const auto& factor : problem_.factors->factors) {
    if (factor->IsThreadSafe()) continue;
    Warn(WarningKind::kSingleThread, factor->name() + " needs one thread, so Ceres used one.",
         &warnings_);
    return true;
  }
  return false;
}

ceres::Solver::Options CeresSolve::ChooseSolver() {
  const ProblemShape shape = ShapeOf(layout_, num_residuals_);
  SolveOptions options = options_;
  const bool cameras_eliminated =
      options.linear_solver_ordering == EliminationOrdering::kCamerasFirst;
  if (options.linear_solver_type == LinearSolverType::kAuto) {
    SolverChoice choice = ChooseCeresSolver(problem_, layout_, shape, cameras_eliminated);
    options.linear_solver_type = choice.type;
    linear_solver_choice_ = std::move(choice.reason);
  }
  ceres::Solver::Options result = TranslateOptions(options);
  Warn(WarningKind::kPreconditionerNotUsed, FindIdlePreconditioner(options), &warnings_);
  Warn(WarningKind::kOrderingNotUsed, FindIdleOrdering(options), &warnings_);
  RefuseTooMuchMemory(options.linear_solver_type, shape, cameras_eliminated);
  if (NothingToEliminate(options.linear_solver_ordering, layout_)) {
    Warn(WarningKind::kOrderingReplaced,
         "The first group of the ordering has no refined parameters: Ceres chose its own.",
         &warnings_);
  }
  if (options.linear_solver_ordering == EliminationOrdering::kPointsFirst &&
      shape.num_free_points > 0 && shape.num_camera_columns > 0) {
    // n steps of conjugate gradients solve n equations. A further step divides zero by zero, which
    // Ceres treats as a failure of the step.
    result.max_linear_solver_iterations = static_cast<int>(
        std::min<int64_t>(result.max_linear_solver_iterations, shape.num_camera_columns));
  }
  result.linear_solver_ordering =
      MakeOrdering(options.linear_solver_ordering, problem_, layout_, numbers_.data(), State());
  return result;
}

int CeresSolve::BlasThreads(const ceres::Solver::Options& options) const {
  const bool factorises = options.linear_solver_type == ceres::DENSE_SCHUR ||
                          options.linear_solver_type == ceres::SPARSE_SCHUR;
  const bool large = layout_.state_size() >= kColumnsWorthBlasThreads;
  return factorises && large ? options.num_threads : 1;
}

void CeresSolve::Collect(const ceres::Solver::Summary& summary, SolveOutput* output) {
  output->summary.linear_solver_choice = std::move(linear_solver_choice_);
  for (Warning& fallback : FindFallbacks(summary)) warnings_.push_back(std::move(fallback));
  output->summary.factor = CountCeresFactor(problem_, layout_, options_.linear_solver_ordering,
                                            summary.linear_solver_type_used);
  for (const ceres::IterationSummary& iteration : summary.iterations) {
    output->iterations.push_back(ToRecord(iteration, fixed_cost_, lengths_));
    record_holding_.Complete(&output->iterations.back());
  }
  output->summary.final_cost =
      CostOfWhatCounts(output->iterations).value_or(output->summary.final_cost);
  if (best_cost_) output->summary.final_cost = *best_cost_ + fixed_cost_;
  output->summary.held_cost = watch_.state_cost.load();
  output->cam_from_world = states_.CamFromWorld();
  output->rig_from_world = states_.RigFromWorld();
  output->sensor_from_rig = states_.SensorFromRig();
  output->camera_params = states_.camera_params();
  output->points.assign(numbers_.data(), State());
  output->twists = states_.Twists();
  output->readouts = states_.readouts();
  if (options_.check_solution) {
    output->summary.num_information_nonzeros = NumInformationNonzeros(problem_, layout_);
  }
  FinishSolve(problem_, layout_, states_, options_, std::move(warnings_), watch_.num_held.load(),
              output);
}

SolveOutput SolveWithCeres(const AdjustmentProblem& problem, const SolveOptions& options,
                           PreparedSolve prepared, const ProgressCallback& progress,
                           const MeasureDecrement& measure) {
  return CeresSolve(problem, options, std::move(prepared), measure).Run(progress);
}

const char* CeresVersion() { return CERES_VERSION_STRING; }

}  // namespace bundle
