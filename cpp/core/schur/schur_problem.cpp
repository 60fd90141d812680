#include "core/schur/schur_problem.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/model/factor_costs.h"
#include "core/model/gauge.h"
#include "core/parallel/thread_pool.h"
#include "core/schur/assembly/sum_systems.h"
#include "core/schur/camera_factors.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/for_chunks.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/state_records.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

// Uncertainty relative to the cost. It is thousands of times the change of the sum when its order
// changes, which is a few units in the last place. So rounding decides on the last digit of about
// one quality in ten thousand.
constexpr double kCostUncertainty = 0x1p-38;

double Dot(const std::vector<double>& a, const std::vector<double>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

}  // namespace

SchurProblem::SchurProblem(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const SolveOptions& options, BlockStructure structure,
                           LinearSolver* solver, bool is_reused, ThreadPool* pool)
    : own_pool_(pool != nullptr
                    ? nullptr
                    : std::make_unique<ThreadPool>(EffectiveNumThreads(options.num_threads))),
      pool_(pool != nullptr ? *pool : *own_pool_),
      setup_(problem, layout, options, std::move(structure), is_reused, solver->NeedsProduct(),
             &pool_),
      solver_(solver),
      factors_(problem, layout, structure_, plan_),
      input_(WithPriors(setup_.input)),
      memory_(pool_.num_threads(), ArenaVector<double>(kernels_.memory_doubles(input_) + 8)),
      states_{State(problem, layout, plan_), State(problem, layout, plan_)},
      step_(problem, layout),
      other_step_(problem, layout),
      squared_scale_(x_->points.size(), 0.0),
      sums_(input_, setup_.structure_of_sums(), setup_.assembler_of_sums(),
            setup_.parts.num_own_parts(), pool_.num_threads(),
            solver->NeedsCameraDiagonal() || setup_.part_sums != nullptr,
            /*keeps_error_terms=*/setup_.sums == SumOrder::kSections),
      bounds_(layout.Bounds(problem)) {
  const auto n = static_cast<size_t>(structure_.num_columns());
  scale_.resize(n);
  d_squared_.resize(n);
  newton_.resize(n);
  // A hard-tied twist has no column of its own, by whose norm the grid could be chosen.
  if (setup_.sums == SumOrder::kGrid && !layout.HasHardTwists()) {
    grid_ = std::make_unique<SumGrid>(input_, assembler_, structure_, setup_.parts.num_parts());
    sums_.UseGrid(grid_.get());
  }
  if (solver_->NeedsProduct()) {
    solver_->SetProduct([this](const double* from, double* to) { MultiplySchur(from, to); });
  }
  KeepRecords();
  has_camera_factors_ = BroadcastFirst(communicator_, factors_.has_camera_factors() ? 1 : 0) > 0;
  MeasureStart(options);
}

void SchurProblem::Reset(const SolveOptions& options) {
  setup_.Reset(options);
  if (grid_ != nullptr) grid_->Forget();
  input_ = WithPriors(setup_.input);
  KeepRecords();
  x_ = &states_[0];
  candidate_ = &states_[1];
  kept_.reset();
  for (State& state : states_) state.Reset(layout_, plan_);
  solver_->ForgetValues();
  scaled_ = false;
  MeasureStart(options);
}

void SchurProblem::FreeSteps() {
  sums_.FreeSystem();
  BlockValues().swap(mapped_sums_.system.values);
  for (LargeVector<double>* values : {&candidate_->points, &squared_scale_, &points_p_, &points_q_,
                                      &points_d_squared_, &points_line_, &kept_records_})
    LargeVector<double>().swap(*values);
}

NewtonResult SchurProblem::SolveNewton(double eta) {
  if (solver_->NeedsGaugeDirections()) {
    system().gauge_directions = GaugeDirections(problem_, layout_, x_->cameras());
  }
  LinearSolution solution;
  if (IsFirst(communicator_)) {
    solution = solver_->Solve(&system(), scale_, eta, newton_.data());
  }
  BroadcastSolution(communicator_, &solution, &newton_);
  NewtonResult result{solution.status, solution.num_iterations, solution.message};
  const bool finite = std::all_of(newton_.begin(), newton_.end(),
                                  [](double value) { return std::isfinite(value); });
  if (result.status == LinearStatus::kSuccess && !finite) {
    result.status = LinearStatus::kFailure;
  }
  return result;
}

Candidate SchurProblem::EvaluateNewtonStep() {
  step_.Set(newton_, x_->cameras());
  MoveCameras(newton_);
  std::vector<CandidateSum> parts(plan_.chunks.size());
  const StateRecords x = x_->records();
  ForChunks([&](int c, int thread) {
    kernels_.evaluate_newton_step(input_, x, plan_.chunks[c], damping_, squared_scale_.data(),
                                  step_.records(), candidate_->CandidateRecords(x, c),
                                  candidate_->points.data(), Memory(thread), &parts[c]);
  });
  CandidateTotal total = Total(parts);
  total.model_cost_change.Add(factors_.ModelCostChange(newton_));
  line_ = newton_;
  return Finish(newton_, total);
}

Candidate SchurProblem::EvaluateDoglegStep(double a, double b) {
  std::vector<double> step(newton_.size());
  for (size_t j = 0; j < step.size(); ++j) step[j] = a * gradient_direction_[j] + b * newton_[j];
  MoveCameras(step);
  const CandidateTotal total =
      MovePoints([&](int64_t i) { return a * points_p_[i] + b * points_q_[i]; });
  const DoglegProducts& d = products_;
  line_ = step;
  Candidate result = Finish(step, total);
  result.model_cost_change =
      -(a * d.d_pp + b * d.d_pq) - 0.5 * (a * a * d.j_pp + 2 * a * b * d.j_pq + b * b * d.j_qq);
  return result;
}

StepLine SchurProblem::LineAlongStep() {
  points_line_.resize(x_->points.size());
  for (size_t i = 0; i < points_line_.size(); ++i) {
    points_line_[i] = candidate_->points[i] - x_->points[i];
  }
  StepLine line;
  line.slope = SlopeAt(*x_);
  const auto add = [&](const auto& step) {
    for (const double value : step) line.max_norm = std::max(line.max_norm, std::abs(value));
  };
  add(line_);
  add(points_line_);
  line.max_norm = MaxOverRanks(communicator_, line.max_norm);
  return line;
}

Candidate SchurProblem::EvaluateAlongStep(double a) {
  std::vector<double> step(line_.size());
  for (size_t j = 0; j < step.size(); ++j) step[j] = a * line_[j];
  MoveCameras(step);
  return Finish(step, MovePoints([&](int64_t i) { return a * points_line_[i]; }));
}

double SchurProblem::SlopeAtCandidate() { return SlopeAt(*candidate_); }

void SchurProblem::Accept() {
  std::swap(x_, candidate_);
  std::swap(state_norm_, candidate_norm_);
  std::swap(x_cost_, candidate_cost_);
  std::swap(kind_costs_, candidate_kind_costs_);
  std::swap(x_held_cost_, candidate_held_cost_);
  x_->MoveAnchors();
}

NewtonDecrement SchurProblem::Decrement() {
  constexpr double kExactly = 0;
  if (SolveNewton(kExactly).status != LinearStatus::kSuccess) return {};
  // The solver may have overwritten the values of S, not the right-hand side.
  const double cameras = BroadcastFirst(
      communicator_, IsFirst(communicator_) ? Dot(camera_sums().system.rhs, newton_) : 0);
  return {std::sqrt(point_decrement_ + cameras), std::sqrt(cameras)};
}

bool SchurProblem::ReleaseHeld() {
  const auto counts = [this](const HeldResidual& held) {
    double residual[2];
    return ResidualOf(held, residual);
  };
  if (SumOverRanks(communicator_, x_->held.Release(counts)) == 0) return false;
  solver_->ForgetValues();
  scaled_ = false;
  return true;
}

EliminationInput SchurProblem::WithPriors(EliminationInput input) const {
  input.point_prior = factors_.point_prior();
  input.prior_sums = factors_.prior_sums();
  return input;
}

void SchurProblem::MeasureStart(const SolveOptions& options) {
  const double points_squared = RoundOverRanks(communicator_, x_->FreePointsSquared(plan_));
  state_norm_ = std::sqrt(Dot(x_->camera_state, x_->camera_state) + points_squared);
  DoubleDouble fixed_cost = setup_.FixedCost(options);
  fixed_cost.Add(factors_.FixedCost(x_->cameras()));
  fixed_cost_ = RoundOverRanks(communicator_, fixed_cost);
  std::vector<DoubleDouble> kinds;
  factors_.Cost(x_->cameras(), x_->points.data(), &kinds);
  kind_costs_ = RoundOverRanks(communicator_, "scalars", kinds);
  degrees_of_freedom_ = CountDegreesOfFreedom(options);
  moves_quaternions_ = options.convergence == ConvergenceRule::kColmap;
}

std::optional<double> SchurProblem::CountDegreesOfFreedom(const SolveOptions& options) const {
  if (options.convergence != ConvergenceRule::kSigmas) return std::nullopt;
  int64_t degrees = 2 * num_active_observations() + factors_.num_residuals();
  for (int i = 0; i < plan_.num_free_points; ++i) {
    degrees -= std::min<int64_t>(3, 2 * (plan_.first[i + 1] - plan_.first[i]));
  }
  const int64_t all = SumOverRanks(communicator_, degrees) - layout_.state_size();
  return options.loss == LossType::kTrivial ? static_cast<double>(all) : 0;
}

void SchurProblem::MoveCameras(const std::vector<double>& step) {
  for (size_t j = 0; j < step.size(); ++j) {
    candidate_->camera_state[j] = bounds_.Project(j, x_->camera_state[j] + step[j]);
  }
  candidate_->ShareAnchors(*x_);
  candidate_->Update();
}

double SchurProblem::ProjectedStep(size_t j, double step) const {
  if (!HasBounds()) return step;
  return bounds_.Project(j, x_->camera_state[j] + step) - x_->camera_state[j];
}

SchurProblem::CandidateTotal SchurProblem::Total(const std::vector<CandidateSum>& parts) {
  CandidateTotal total;
  for (const CandidateSum& part : parts) {
    total.model_cost_change.Add(part.model_cost_change);
    total.cost.Add(part.cost);
    total.step_squared.Add(part.step_squared);
    total.state_squared.Add(part.state_squared);
  }
  return total;
}

template <typename PointStep>
SchurProblem::CandidateTotal SchurProblem::MovePoints(const PointStep& point_step) {
  std::vector<CandidateSum> parts(plan_.chunks.size());
  const StateRecords x = x_->records();
  ForChunks([&](int c, int) {
    MovePoints(plan_.chunks[c], point_step, &parts[c]);
    parts[c].cost = kernels_.cost(input_, candidate_->CandidateRecords(x, c), plan_.chunks[c]);
  });
  return Total(parts);
}

template <typename PointStep>
void SchurProblem::MovePoints(const Chunk& chunk, const PointStep& point_step, CandidateSum* sum) {
  if (chunk.first_row > 0) return;
  for (int64_t i = 3 * static_cast<int64_t>(chunk.first_point);
       i < 3 * static_cast<int64_t>(chunk.last_point); ++i) {
    const bool free = i < 3 * static_cast<int64_t>(plan_.num_free_points);
    const double step = free ? point_step(i) : 0;
    candidate_->points[i] = x_->points[i] + step;
    if (!free) continue;
    sum->step_squared += step * step;
    sum->state_squared += candidate_->points[i] * candidate_->points[i];
  }
}

double SchurProblem::SlopeAt(const State& state) {
  step_.Set(line_, state.cameras());
  std::vector<double> parts(plan_.chunks.size());
  ForChunks([&](int c, int thread) {
    parts[c] = kernels_.slope(input_, state.records(), plan_.chunks[c], step_.records(),
                              points_line_.data(), Memory(thread));
  });
  DoubleDouble slope;
  slope.Add(factors_.Slope(state.cameras(), state.points.data(), line_, points_line_.data()));
  for (const double part : parts) slope.Add(part);
  return RoundOverRanks(communicator_, slope);
}

Candidate SchurProblem::Finish(const std::vector<double>& step, CandidateTotal sum) {
  candidate_->held.Merge();
  DoubleDouble changes;
  changes.Add(candidate_->held.HasSameObservations(x_->held) ? 0 : 1);
  std::vector<DoubleDouble> kinds;
  sum.cost.Add(factors_.Cost(candidate_->cameras(), candidate_->points.data(), &kinds));
  DoubleDouble held_cost = candidate_->held.Cost(input_.loss, input_.loss_scale);
  RoundOverRanks(communicator_, {&changes, &sum.model_cost_change, &sum.cost, &held_cost,
                                 &sum.step_squared, &sum.state_squared});
  candidate_kind_costs_ = RoundOverRanks(communicator_, "scalars", kinds);
  candidate_norm_ =
      std::sqrt(Dot(candidate_->camera_state, candidate_->camera_state) + sum.state_squared.sum);
  Candidate result;
  result.changes_what_counts = changes.sum > 0;
  result.model_cost_change = sum.model_cost_change.sum;
  double step_squared = 0;
  for (size_t j = 0; j < step.size(); ++j) {
    const double moved = ProjectedStep(j, step[j]);
    step_squared += moved * moved;
  }
  result.step_norm = std::sqrt(step_squared + sum.step_squared.sum);
  result.cost = candidate_cost_ = sum.cost.sum;
  result.held_cost = candidate_held_cost_ = held_cost.sum;
  if (grid_ != nullptr) result.cost_uncertainty = kCostUncertainty * x_cost_;
  result.has_factors = !kind_costs_.empty();
  result.factors_change =
      LargestRelativeChange(kind_costs_, candidate_kind_costs_, factors_.expected_costs());
  return result;
}

}  // namespace bundle
