#include "core/ceres/solve_with_ceres.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdio>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/ceres/active_bounds.h"
#include "core/ceres/ceres_graph.h"
#include "core/ceres/losses.h"
#include "core/ceres/reprojection_cost.h"
#include "core/ceres/settle_factors.h"
#include "core/ceres/summarize.h"
#include "core/ceres/translate_options.h"
#include "core/ceres/untaken_decrease.h"
#include "core/checking/check_solution.h"
#include "core/checking/lost_observations.h"
#include "core/interface/summary.h"
#include "core/model/camera_states.h"
#include "core/model/coupled_blocks.h"
#include "core/model/parameter_layout.h"
#include "core/model/problem_factors.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/choose_solver.h"
#include "core/prepare/memory.h"
#include "core/prepare/prepare.h"

namespace bundle {
namespace {

/// Expands the camera parameters once per evaluation. Looks for an interruption before a candidate
/// is evaluated: Ceres has no other moment within a step at which it can be left with the best
/// state. From then on no cost can be evaluated, and the candidate is rejected.
class UpdateCameraStates final : public ceres::EvaluationCallback {
 public:
  UpdateCameraStates(const double* state, CameraStates* states, HoldingWatch* watch,
                     ActiveBounds* bounds, StepLengths* lengths, Abandonment* abandonment)
      : state_(state),
        states_(states),
        watch_(watch),
        bounds_(bounds),
        lengths_(lengths),
        abandonment_(abandonment) {}

  void PrepareForEvaluation(bool evaluate_jacobians, bool new_evaluation_point) override {
    if (!evaluate_jacobians && InterruptionRequested())
      abandonment_->happened.store(true, std::memory_order_relaxed);
    if (new_evaluation_point) states_->Update(state_);
    // Ceres has evaluated the cost at every state but the first when it asks for derivatives there.
    const bool is_at_state = evaluate_jacobians && !(new_evaluation_point && has_start_);
    watch_->is_at_start.store(is_at_state && !has_start_ && all_count_);
    has_start_ = has_start_ || evaluate_jacobians;
    lengths_->Evaluate(is_at_state);
    watch_->is_at_candidate.store(true);  // no evaluation of ours is one at a state
    if (is_at_state) {
      states_->MoveAnchors();
      bounds_->Find();
    }
    watch_->is_at_candidate.store(!is_at_state);
    (is_at_state ? watch_->state_cost : watch_->candidate_cost).store(0);
  }

  /// Before a solve. `all_count`: all observations count that can, at its start.
  void BeginSolve(bool all_count) {
    has_start_ = false;
    all_count_ = all_count;
    watch_->has_changed.store(false);
  }

 private:
  const double* state_;
  CameraStates* states_;
  HoldingWatch* watch_;
  ActiveBounds* bounds_;
  StepLengths* lengths_;
  Abandonment* abandonment_;
  bool has_start_ = false;  ///< the derivatives at the start
  bool all_count_ = true;
};

/// Remembers of each iteration whether other observations counted at the candidate than at the
/// state, and the held cost that is part of its cost. An iteration is one of several solves, each
/// of which goes on from the end of the one before.
class RecordHolding final : public ceres::IterationCallback {
 public:
  explicit RecordHolding(HoldingWatch* watch) : watch_(watch) {}

  /// `repeats`: the next solve begins with the last iteration of the one before.
  void BeginSolve(bool repeats) {
    if (repeats) records_.pop_back();
    first_ = static_cast<int>(records_.size());
    changes_ = !repeats && first_ > 0;
  }

  /// Forgets iterations of the current solve that its summary does not have.
  void EndSolve(size_t num_iterations) { records_.resize(first_ + num_iterations); }

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    const bool is_at_state = iteration.step_is_successful || !iteration.step_is_valid;
    const double held = is_at_state ? watch_->state_cost : watch_->candidate_cost;
    const bool changed = watch_->has_changed.exchange(false);
    records_.push_back({changed || (changes_ && iteration.iteration == 0), held});
    return ceres::SOLVER_CONTINUE;
  }

  /// Puts what it knows into the record of an iteration of the current solve, which gets the number
  /// that it has among those of all.
  void CompleteCurrent(IterationRecord* record) const {
    record->iteration += first_;
    Complete(record);
  }
  void Complete(IterationRecord* record) const {
    if (record->iteration >= static_cast<int>(records_.size())) return;
    const Record& known = records_[record->iteration];
    record->changes_what_counts = known.changed;
    record->cost -= known.held_cost;
  }

 private:
  struct Record {
    bool changed;
    double held_cost;
  };

  HoldingWatch* watch_;
  std::vector<Record> records_;
  int first_ = 0;
  bool changes_ = false;
};

/// Remembers the anchors of the state that Ceres ends with: the best one, which others may follow
/// that rounding keeps from being better; or the start, if the solve fails.
class RememberAnchors final : public ceres::IterationCallback {
 public:
  explicit RememberAnchors(const CameraStates& states)
      : states_(states), start_(states.anchors()), best_(start_) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& iteration) override {
    const bool is_best = iteration.step_is_successful && !iteration.step_is_nonmonotonic;
    if (is_best) best_ = states_.anchors();
    return ceres::SOLVER_CONTINUE;
  }

  const std::shared_ptr<const PoseAnchors>& AtEnd(const ceres::Solver::Summary& summary) const {
    return summary.IsSolutionUsable() ? best_ : start_;
  }

 private:
  const CameraStates& states_;
  const std::shared_ptr<const PoseAnchors> start_;
  std::shared_ptr<const PoseAnchors> best_;
};

/// The next part of a solve that Ceres calls converged.
struct Continuation {
  /// From the state that it has, with what is held: Ceres compares changes of the cost with a cost
  /// that includes it. Otherwise all observations count that can.
  bool repeats = false;
  /// The share that the rest is of that cost.
  double share = 1;
};

/// One solve, in the order of its methods.
class CeresSolve {
 public:
  CeresSolve(const AdjustmentProblem& problem, const SolveOptions& options, PreparedSolve prepared)
      : problem_(problem),
        options_(options),
        warnings_(std::move(prepared.warnings)),
        layout_(std::move(prepared.layout)),
        states_(problem, layout_),
        num_coordinates_(3 * static_cast<int64_t>(problem.num_points)),
        numbers_(StartNumbers(problem, layout_)),
        update_states_(State(), &states_, &watch_, &active_bounds_, &lengths_, &abandonment_),
        context_{problem_, layout_, states_, options.cheirality, &watch_, &abandonment_.happened},
        loss_(MakeLoss(options.loss, options.loss_scale)) {
    watch_.loss = options.loss;
    watch_.loss_scale = options.loss_scale;
  }

  SolveOutput Run(const ProgressCallback& progress) {
    RefuseTooMuchMemory(PredictCeresWorkingBytes(
        ShapeOf(layout_, 2 * static_cast<int64_t>(problem_.num_observations))));
    BuildProblem();
    ThrowIfInterrupted();
    ceres::Solver::Options ceres_options = ChooseSolver();
    // Ceres would not start otherwise where the system has no more threads.
    ceres_options.num_threads =
        UseOneThread() ? 1 : CountStartableThreads(ceres_options.num_threads);
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
    Collect(summary, &output);
    return output;
  }

 private:
  ceres::Solver::Summary SolveOnce(const ProgressCallback& progress,
                                   ceres::Solver::Options ceres_options, SolveOutput* output,
                                   const Continuation& continuation = {}) {
    const bool repeats = continuation.repeats;
    const ProgressCallback complete = [&](const IterationRecord& iteration) {
      if (repeats && iteration.iteration == 0) return true;  // it is known
      IterationRecord record = iteration;
      record_holding_.CompleteCurrent(&record);
      return !progress || progress(record);
    };
    ReportProgress report(complete, fixed_cost_, lengths_, abandonment_.happened);
    RememberAnchors remember_anchors(states_);
    ceres_options.callbacks = {&remember_anchors, &record_holding_, &lengths_, &report};
    update_states_.BeginSolve(/*all_count=*/!repeats);
    record_holding_.BeginSolve(repeats);
    lengths_.BeginSolve();
    ceres::Solver::Summary summary;
    ceres::Solve(ceres_options, ceres_problem_.get(), &summary);
    states_.SetAnchors(remember_anchors.AtEnd(summary));
    if (!factor_costs_.empty() && EndedByTolerance(summary)) {
      Settle(std::move(ceres_options), &report, &summary);
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
    return summary;
  }

  /// Makes what Ceres says of its function tolerance a share of the cost without what is held.
  void TellOfCostWithoutHeld(ceres::Solver::Summary* summary) const {
    constexpr char kFormat[] = "Function tolerance reached. |cost_change|/cost: %le <= %le";
    double share = 0, tolerance = 0;
    if (share_ == 1 || std::sscanf(summary->message.c_str(), kFormat, &share, &tolerance) != 2) {
      return;
    }
    std::array<char, 128> text;
    std::snprintf(text.data(), text.size(),
                  "Function tolerance reached. |cost_change|/cost: %e <= %e", share / share_,
                  options_.function_tolerance);
    summary->message = text.data();
  }

  /// Steps are judged by the cost with what is held, as Ceres does it (factors/reprojection.h); the
  /// function tolerance is a share of the cost without. And observations that were left out may be
  /// in front of their cameras.
  std::optional<Continuation> FindContinuation(const ceres::Solver::Summary& summary) const {
    const int64_t num_held = watch_.num_held.load();
    if (num_held == 0 || summary.termination_type != ceres::CONVERGENCE) return std::nullopt;
    if (summary.iterations.back().iteration >= options_.max_num_iterations) return std::nullopt;
    const auto last = std::find_if(
        summary.iterations.rbegin(), summary.iterations.rend(),
        [](const ceres::IterationSummary& iteration) { return iteration.step_is_successful; });
    const double share = std::max(0.0, 1 - watch_.state_cost.load() / last->cost);
    const bool by_function = summary.message.rfind("Function tolerance", 0) == 0;
    if (by_function && share < share_) return Continuation{true, share};
    AdjustmentProblem refined = problem_;
    const std::vector<double> poses = states_.CamFromWorld();
    refined.cam_from_world = poses.data();
    refined.camera_params = states_.camera_params().data();
    refined.points = numbers_.data();
    if (CountLeftOut(refined, layout_, options_, num_held) == 0) return std::nullopt;
    return Continuation{};
  }

  ceres::Solver::Options OptionsToGoOn(ceres::Solver::Options result,
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

  void BuildProblem() {
    ceres::Problem::Options problem_options;
    problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    problem_options.manifold_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    problem_options.disable_all_safety_checks = true;  // the layout makes every block once
    problem_options.evaluation_callback = &update_states_;
    ceres_problem_ = std::make_unique<ceres::Problem>(problem_options);

    // In the order of memory, so that Ceres walks through ours as it walks through its own.
    for (int p = 0; p < problem_.num_points; ++p) {
      if (layout_.point_is_free(p)) ceres_problem_->AddParameterBlock(PointData(p), 3);
    }
    for (const CameraBlock& block : layout_.blocks()) {
      ceres_problem_->AddParameterBlock(State() + block.offset, block.size);
    }
    AddBounds();
    costs_.reserve(problem_.num_observations);
    for (int64_t i = 0; i < problem_.num_observations; ++i) AddObservation(i);
    num_residuals_ = 2 * static_cast<int64_t>(costs_.size());
    if (problem_.factors == nullptr) return;
    for (const auto& factor : problem_.factors->factors) AddFactor(*factor);
  }

  void Settle(ceres::Solver::Options options, ReportProgress* report,
              ceres::Solver::Summary* summary) {
    update_states_.BeginSolve(/*all_count=*/false);
    lengths_.Restart();
    RememberAnchors remember_anchors(states_);
    options.linear_solver_ordering =
        MakeOrdering(options_.linear_solver_ordering, problem_, layout_, numbers_.data(), State());
    const auto anchors = states_.anchors();
    const bool went_on = SettleFactors(factor_costs_, std::move(options),
                                       {&remember_anchors, &record_holding_, &lengths_, report},
                                       ceres_problem_.get(), summary);
    states_.SetAnchors(went_on ? remember_anchors.AtEnd(*summary) : anchors);
  }

  /// Of a factor that is not safe for threads, Ceres would evaluate none at the same time as
  /// others.
  bool UseOneThread() {
    if (problem_.factors == nullptr || options_.num_threads == 1) return false;
    for (const auto& factor : problem_.factors->factors) {
      if (factor->IsThreadSafe()) continue;
      Warn(WarningKind::kSingleThread, factor->name() + " needs one thread, and so Ceres got one.",
           &warnings_);
      return true;
    }
    return false;
  }

  void AddFactor(const Factor& factor) {
    ChartedFactor charted(factor, problem_, layout_);
    if (charted.is_fixed()) {
      fixed_cost_ += charted.Cost(states_, nullptr);
      return;
    }
    std::vector<double*> blocks;
    for (const int point : charted.unknowns().points) blocks.push_back(PointData(point));
    for (const int block : charted.unknowns().blocks) {
      blocks.push_back(State() + layout_.blocks()[block].offset);
    }
    num_residuals_ += charted.num_residuals();
    factor_losses_.push_back(MakeLoss(factor.loss(), factor.loss_scale()));
    costs_.push_back(active_bounds_.Wrap(MakeFactorCost(std::move(charted), states_, &abandonment_),
                                         factor_losses_.back().get(), blocks));
    factor_costs_.Add(KindOf(factor, problem_), *costs_.back(), factor_losses_.back().get(),
                      blocks);
    ceres_problem_->AddResidualBlock(costs_.back().get(), factor_losses_.back().get(), blocks);
  }

  void AddBounds() {
    const StateBounds bounds = layout_.Bounds(problem_);
    if (bounds.empty()) return;
    const bool inexact = options_.linear_solver_type == LinearSolverType::kDenseQr;
    for (const CameraBlock& block : layout_.blocks()) {
      const auto part = [&](const std::vector<double>& of) {
        const auto first = of.begin() + block.offset;
        return std::vector<double>(first, first + block.size);
      };
      active_bounds_.Add(ceres_problem_.get(), State() + block.offset,
                         {part(bounds.lower), part(bounds.upper)}, inexact);
    }
  }

  void AddObservation(int64_t i) {
    const int image = problem_.observation_image[i];
    const int point = problem_.observation_point[i];
    double* blocks[5];
    int num_blocks = 0;
    if (layout_.point_is_free(point)) blocks[num_blocks++] = PointData(point);
    for (const int index : layout_.blocks_of(image)) {
      if (index >= 0) blocks[num_blocks++] = State() + layout_.blocks()[index].offset;
    }
    std::unique_ptr<ceres::CostFunction> cost = MakeReprojectionCost(context_, i);
    if (num_blocks == 0) {
      fixed_cost_ += Cost(*cost);
      return;
    }
    cost = active_bounds_.Wrap(std::move(cost), loss_.get(), {blocks, blocks + num_blocks});
    ceres_problem_->AddResidualBlock(cost.get(), loss_.get(), blocks, num_blocks);
    costs_.push_back(std::move(cost));
  }

  /// 1/2 rho(||r||^2) of an observation with nothing to refine.
  double Cost(const ceres::CostFunction& cost) const {
    double residual[2];
    cost.Evaluate(nullptr, residual, nullptr);
    const double squared = residual[0] * residual[0] + residual[1] * residual[1];
    if (loss_ == nullptr) return 0.5 * squared;
    double rho[3];
    loss_->Evaluate(squared, rho);
    return 0.5 * rho[0];
  }

  ceres::Solver::Options ChooseSolver() {
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
           "Nothing of the ordering's first group is refined: Ceres chose what to eliminate.",
           &warnings_);
    }
    if (options.linear_solver_ordering == EliminationOrdering::kPointsFirst &&
        shape.num_free_points > 0 && shape.num_camera_columns > 0) {
      // n steps of conjugate gradients solve n equations; a further one divides zero by zero, which
      // Ceres takes for a failure of the step.
      result.max_linear_solver_iterations = static_cast<int>(
          std::min<int64_t>(result.max_linear_solver_iterations, shape.num_camera_columns));
    }
    result.linear_solver_ordering =
        MakeOrdering(options.linear_solver_ordering, problem_, layout_, numbers_.data(), State());
    return result;
  }

  /// OpenBLAS' own threads pay for the factorisation of a large reduced system only.
  int BlasThreads(const ceres::Solver::Options& options) const {
    const bool factorises = options.linear_solver_type == ceres::DENSE_SCHUR ||
                            options.linear_solver_type == ceres::SPARSE_SCHUR;
    const bool large = layout_.state_size() >= kColumnsWorthBlasThreads;
    return factorises && large ? options.num_threads : 1;
  }

  void Collect(const ceres::Solver::Summary& summary, SolveOutput* output) {
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
    output->summary.held_cost = watch_.state_cost.load();
    output->cam_from_world = states_.CamFromWorld();
    output->rig_from_world = states_.RigFromWorld();
    output->sensor_from_rig = states_.SensorFromRig();
    output->camera_params = states_.camera_params();
    output->points.assign(numbers_.data(), State());
    if (options_.check_solution) {
      output->summary.num_information_nonzeros = NumInformationNonzeros(problem_, layout_);
    }
    FinishSolve(problem_, layout_, states_, options_, std::move(warnings_), watch_.num_held.load(),
                output);
  }

  static std::vector<double> StartNumbers(const AdjustmentProblem& problem,
                                          const ParameterLayout& layout) {
    const std::vector<double> state = layout.InitialState(problem);
    std::vector<double> numbers(problem.points,
                                problem.points + 3 * static_cast<int64_t>(problem.num_points));
    numbers.insert(numbers.end(), state.begin(), state.end());
    return numbers;
  }

  double* PointData(int point) { return numbers_.data() + 3 * static_cast<int64_t>(point); }
  double* State() { return numbers_.data() + num_coordinates_; }

  const AdjustmentProblem& problem_;
  const SolveOptions& options_;
  std::vector<Warning> warnings_;
  std::string linear_solver_choice_;
  ParameterLayout layout_;
  CameraStates states_;
  HoldingWatch watch_;
  RecordHolding record_holding_{&watch_};
  double share_ = 1;               ///< of the last solve's Continuation
  const int64_t num_coordinates_;  ///< of points
  /// Coordinates of the points, then the state. Ceres orders what it eliminates by address: apart,
  /// the two would stand in either order, and results would end in other digits.
  std::vector<double> numbers_;
  Abandonment abandonment_;
  ActiveBounds active_bounds_;
  StepLengths lengths_;
  UpdateCameraStates update_states_;
  ReprojectionContext context_;
  std::unique_ptr<ceres::LossFunction> loss_;
  std::vector<std::unique_ptr<ceres::LossFunction>> factor_losses_;
  std::vector<std::unique_ptr<ceres::CostFunction>> costs_;
  KindCosts factor_costs_;
  int64_t num_residuals_ = 0;
  std::unique_ptr<ceres::Problem> ceres_problem_;
  double fixed_cost_ = 0;
};

}  // namespace

SolveOutput SolveWithCeres(const AdjustmentProblem& problem, const SolveOptions& options,
                           PreparedSolve prepared, const ProgressCallback& progress) {
  return CeresSolve(problem, options, std::move(prepared)).Run(progress);
}

const char* CeresVersion() { return CERES_VERSION_STRING; }

}  // namespace bundle
