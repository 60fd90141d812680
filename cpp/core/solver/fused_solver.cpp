#include "core/solver/fused_solver.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/checking/check_solution.h"
#include "core/linear/block_structure.h"
#include "core/linear/conjugate_gradients.h"
#include "core/linear/direct_solvers.h"
#include "core/linear/linear_solver.h"
#include "core/minimize/trust_region.h"
#include "core/model/camera_states.h"
#include "core/model/coupled_blocks.h"
#include "core/model/parameter_layout.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/choose_solver.h"
#include "core/prepare/memory.h"
#include "core/prepare/prepare.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/schur_problem.h"
#include "core/schur/schur_setup.h"
#include "core/sums/communicator.h"

namespace bundle {
FusedSolver::FusedSolver(const AdjustmentProblem& problem, const SolveOptions& options,
                         PreparedSolve prepared, bool is_reused)
    : problem_(problem),
      options_(options),
      is_reused_(is_reused),
      layout_(std::move(prepared.layout)),
      track_lengths_(std::move(prepared.track_lengths)) {
  const Stopwatch time;
  ChooseSolver();
  BuildProblem();
  // In a reused solver, no single solve spends this time.
  build_time_ = is_reused ? 0 : time.seconds();
  if (is_reused) factor_.symbolic_time_in_seconds = 0;
}

SolveOutput FusedSolver::Solve(const SolveOptions& options, std::vector<Warning> warnings,
                               const ProgressCallback& progress) {
  const Stopwatch total;
  CopyChangeable(options, &options_);
  if (is_reused_) schur_->Reset(options_);
  SolveTimes times;
  times.preprocessor = build_time_ + total.seconds();

  const Stopwatch minimizer;
  const ProgressCallback report = AddFixedCost(progress);
  MinimizerSummary minimum = Minimize(options_, report, schur_.get());
  while (MayGoOn(minimum) && schur_->ReleaseHeld()) {
    minimum = Minimize(options_, report, schur_.get(), std::move(minimum));
  }
  times.minimizer = minimizer.seconds();

  const Stopwatch postprocessor;
  if (!is_reused_) schur_->FreeSteps();
  SolveOutput output;
  CollectState(&output);
  times.postprocessor = postprocessor.seconds();
  times.total = build_time_ + total.seconds();
  output.solve_time_in_seconds = times.total;

  output.summary = Summarize(options_, layout_, *schur_, minimum, times);
  output.summary.linear_solver_choice = linear_solver_choice_;
  output.summary.factor = factor_;
  if (options_.check_solution) output.summary.num_information_nonzeros = CountInformation();
  output.iterations = std::move(minimum.iterations);
  for (IterationRecord& record : output.iterations) record.cost += schur_->fixed_cost();
  warnings.insert(warnings.end(), warnings_.begin(), warnings_.end());
  FinishSolve(problem_, layout_, schur_->cameras(), options_, std::move(warnings),
              SumOverRanks(problem_.division.communicator, schur_->num_held()), &output);
  return output;
}

NewtonDecrement FusedSolver::Decrement() {
  if (!schur_->HasDecrement()) return {};
  schur_->Linearize(LeastSquares::kDecrementDamping);
  return schur_->Decrement();
}

bool FusedSolver::MayGoOn(const MinimizerSummary& minimum) const {
  return minimum.HasConverged() &&
         minimum.iterations.back().iteration < options_.max_num_iterations;
}

void FusedSolver::ChooseSolver() {
  const ProblemShape shape = ShapeOf(layout_, 2 * problem_.num_observations);
  if (options_.linear_solver_type == LinearSolverType::kAuto) ChooseBySize(shape);
  ChooseSystem();
  CheckTrustRegion(options_);
  Warn(WarningKind::kPreconditionerNotUsed, FindIdlePreconditioner(options_), &warnings_);
  RefuseTooMuchMemory(options_.linear_solver_type, shape, /*cameras_eliminated=*/false);
  working_bytes_ = PredictFusedWorkingBytes(
      layout_, track_lengths_, problem_.observation_sigma != nullptr,
      /*has_pairs=*/!is_implicit_, EffectiveNumThreads(options_.num_threads), BufferBytes());
  track_lengths_ = {};
  RefuseTooMuchMemory(working_bytes_);
  if (options_.preconditioner_type == PreconditionerType::kAuto) {
    options_.preconditioner_type =
        is_implicit_ ? PreconditionerType::kSchurJacobi : PreconditionerType::kTwoLevel;
  }
  options_.num_threads = EffectiveNumThreads(options_.num_threads);
}

/// Maximum bytes of a chunk's buffer: a block for each pair of images.
double FusedSolver::BufferBytes() const {
  double columns = 0;
  for (const CameraBlock& block : layout_.blocks()) columns = std::max<double>(columns, block.size);
  const double images = problem_.num_images;
  return std::min<double>(kMaxBufferBytes,
                          sizeof(double) * columns * columns * images * (images + 1) / 2);
}

/// With fewer than a few hundred columns, even building the structure takes longer than a dense
/// factorisation.
void FusedSolver::ChooseBySize(const ProblemShape& shape) {
  constexpr int64_t kColumnsWorthALook = 300;
  SolverChoice choice;
  if (shape.num_camera_columns < kColumnsWorthALook) {
    choice.reason = "The reduced camera system (" + std::to_string(shape.num_camera_columns) +
                    " columns) is small: its dense factorisation costs less than a millisecond.";
  } else {
    FindSparseStructure();
    // If results must be the same for any number of threads, the choice must not depend on it.
    const int num_threads = options_.deterministic ? 1 : options_.num_threads;
    const auto columns = static_cast<double>(shape.num_camera_columns);
    const double available = AvailableMemoryFor(sizeof(double) * columns * columns);
    choice = ChooseLinearSolver(structure_, ordering_, num_threads, available,
                                NumObservationsWithoutSystem(), NumPairs());
    const double type =
        BroadcastFirst(problem_.division.communicator, static_cast<double>(choice.type));
    choice.type = static_cast<LinearSolverType>(std::lround(type));
  }
  options_.linear_solver_type = choice.type;
  linear_solver_choice_ = std::move(choice.reason);
}

/// Why conjugate gradients need S; "" if they can work without it.
std::string FusedSolver::ReasonForSystem() const {
  if (problem_.division.communicator != nullptr) return "several ranks";
  if (problem_.factors != nullptr) return "factors";
  if (!layout_.Bounds(problem_).empty()) return "bounds";
  const PreconditionerType type = options_.preconditioner_type;
  const bool is_local =
      type == PreconditionerType::kAuto || type == PreconditionerType::kIdentity ||
      type == PreconditionerType::kJacobi || type == PreconditionerType::kSchurJacobi;
  return is_local ? "" : std::string(NameOf(type, kPreconditionerTypes));
}

/// The observations if conjugate gradients may work without S, 0 otherwise.
int64_t FusedSolver::NumObservationsWithoutSystem() const {
  const bool may = options_.schur_complement != SchurComplement::kExplicit &&
                   options_.trust_region_strategy_type == TrustRegionStrategy::kLevenbergMarquardt;
  return may && ReasonForSystem().empty() ? problem_.num_observations : 0;
}

/// Pairs of observations of the same point.
int64_t FusedSolver::NumPairs() const {
  int64_t pairs = 0;
  for (const int64_t length : track_lengths_) pairs += length * (length - 1) / 2;
  return pairs;
}

/// Decides if conjugate gradients form S, before it is built.
void FusedSolver::ChooseSystem() {
  const bool is_iterative = options_.linear_solver_type == LinearSolverType::kIterativeSchur;
  if (!is_iterative) return;
  if (options_.schur_complement == SchurComplement::kImplicit) {
    const std::string reason = ReasonForSystem();
    if (!reason.empty()) {
      throw InputError("schur_complement: expected auto or explicit with " + reason +
                       ", found implicit");
    }
    is_implicit_ = true;
    return;
  }
  const int64_t observations = NumObservationsWithoutSystem();
  if (observations == 0) return;
  if (structure_.offset.empty()) FindSparseStructure();
  const int num_threads = options_.deterministic ? 1 : options_.num_threads;
  const LinearSolverCosts costs =
      PredictLinearSolverCosts(structure_, ordering_, num_threads, observations, NumPairs());
  is_implicit_ = LeavesOutSystem(costs, AvailableMemoryFor(costs.iterative.bytes));
}

void FusedSolver::FindSparseStructure() {
  ThrowIfInterrupted();
  const Stopwatch symbolic;
  structure_ = SparseStructure(layout_.BlockSizes(),
                               FindCoupledBlocks(problem_, layout_, options_.num_threads));
  if (IsFirst(problem_.division.communicator)) ordering_ = FindFillOrdering(structure_);
  BroadcastOrdering();
  symbolic_time_ += symbolic.seconds();
}

/// Only rank 0 searches for an ordering.
void FusedSolver::BroadcastOrdering() {
  Communicator* const communicator = problem_.division.communicator;
  if (communicator == nullptr) return;
  std::vector<double> numbers(ordering_.order.begin(), ordering_.order.end());
  numbers.resize(structure_.num_blocks());
  numbers.insert(numbers.end(), {ordering_.entries, ordering_.flops, ordering_.elimination_flops});
  BroadcastFirst(communicator, "setup", &numbers);
  ordering_.elimination_flops = numbers.back();
  ordering_.flops = numbers[numbers.size() - 2];
  ordering_.entries = numbers[numbers.size() - 3];
  ordering_.order.assign(numbers.begin(), numbers.end() - 3);
  ordering_.name = FirstOverRanks(communicator, ordering_.name);
}

/// After the choice of the solver, which refers to the times with the orderings before it.
void FusedSolver::TryMinimumFill() {
  const Stopwatch symbolic;
  if (IsFirst(problem_.division.communicator)) {
    ordering_ = bundle::TryMinimumFill(structure_, std::move(ordering_));
  }
  BroadcastOrdering();
  symbolic_time_ += symbolic.seconds();
}

void FusedSolver::BuildProblem() {
  if (options_.linear_solver_type == LinearSolverType::kDenseSchur) {
    structure_ = DenseStructure(layout_.BlockSizes());
  } else if (structure_.offset.empty()) {
    FindSparseStructure();
  }
  if (options_.linear_solver_type == LinearSolverType::kSparseSchur) TryMinimumFill();
  if (options_.linear_solver_type != LinearSolverType::kDenseSchur) {
    // All ranks use the order of the elimination as the order of the blocks. Images that share
    // points are near each other in it, which also makes the passes over points faster.
    layout_.Reorder(ordering_.order);
    structure_ = Reorder(structure_, ordering_.order);
    if (is_implicit_) {
      factor_ = bundle::SummarizeFactor(structure_, {}, symbolic_time_);  // of S, were it formed
      structure_ =
          SparseStructure(layout_.BlockSizes(), FindDirectlyCoupledBlocks(problem_, layout_));
    }
  }
  ThrowIfInterrupted();
  const Stopwatch symbolic;
  pool_ = std::make_unique<ThreadPool>(options_.num_threads);
  solver_ = IsFirst(problem_.division.communicator) ? MakeSolver() : nullptr;
  if (problem_.division.communicator != nullptr) {
    const double needs =
        IsFirst(problem_.division.communicator) && solver_->NeedsCameraDiagonal() ? 1 : 0;
    const bool wants_diagonal = BroadcastFirst(problem_.division.communicator, needs) > 0;
    const bool is_iterative = options_.linear_solver_type == LinearSolverType::kIterativeSchur;
    if (solver_ == nullptr) solver_ = MakeRemoteSolver(wants_diagonal, is_iterative);
  }
  symbolic_time_ += symbolic.seconds();
  SummarizeFactor();
  RefuseTooMuchMemory(options_.linear_solver_type, sizeof(double) * NumSystemValues(),
                      working_bytes_);
  ThrowIfInterrupted();
  schur_ = std::make_unique<SchurProblem>(problem_, layout_, options_, std::move(structure_),
                                          solver_.get(), is_reused_, pool_.get());
}

/// Number of values of S, and of its error terms if its sums are double-doubles.
double FusedSolver::NumSystemValues() const {
  const BlockStructure& s = structure_;
  auto values = static_cast<double>(s.num_values);
  const SumOrder order =
      ChooseSumOrder(options_.linear_solver_type, s.num_columns(), s.num_blocks(),
                     static_cast<int64_t>(s.row_block.size()), /*has_maps=*/false, is_implicit_);
  if (order != SumOrder::kSections) return values;
  for (int j = 0; j < s.num_blocks(); ++j) {
    for (int64_t e = s.column_begin[j]; e < s.column_begin[j + 1]; ++e) {
      values += static_cast<double>(s.block_size(j)) * s.block_size(s.row_block[e]);
    }
  }
  return values;
}

void FusedSolver::SummarizeFactor() {
  if (is_implicit_) return;
  const FactorStatistics statistics = solver_->factor_statistics();
  factor_ = bundle::SummarizeFactor(structure_, statistics, symbolic_time_);
  Warn(WarningKind::kFactorLargerThanPredicted, FindSwollenFactor(statistics), &warnings_);
}

/// Only factorisations by OpenBLAS' threads have rounding that depends on their number. Doglegs,
/// with nearly no damping, would amplify it most.
std::unique_ptr<LinearSolver> FusedSolver::MakeSolver() {
  const bool is_dogleg =
      options_.trust_region_strategy_type != TrustRegionStrategy::kLevenbergMarquardt;
  switch (options_.linear_solver_type) {
    case LinearSolverType::kDenseSchur:
      return MakeDenseSolver(structure_, options_.num_threads,
                             /*same_bits=*/options_.deterministic || is_dogleg, pool_.get());
    case LinearSolverType::kSparseSchur:
      return MakeSparseSolver(ordering_, options_.num_threads, &structure_, pool_.get());
    default:
      return MakeIterativeSolver(structure_, options_.preconditioner_type, options_.num_threads,
                                 is_implicit_);
  }
}

ProgressCallback FusedSolver::AddFixedCost(const ProgressCallback& progress) const {
  if (!progress) return progress;
  return [this, &progress, fixed_cost = schur_->fixed_cost()](const IterationRecord& iteration) {
    IterationRecord record = iteration;
    record.cost += fixed_cost;
    // The user's request on one rank ends the solve on all ranks.
    return BroadcastFirst(problem_.division.communicator, progress(record) ? 1.0 : 0.0) > 0;
  };
}

void FusedSolver::CollectState(SolveOutput* output) {
  const CameraStates& cameras = schur_->cameras();
  output->cam_from_world = cameras.CamFromWorld();
  output->rig_from_world = cameras.RigFromWorld();
  output->sensor_from_rig = cameras.SensorFromRig();
  output->camera_params = cameras.camera_params();
  output->points = schur_->Points();
  output->twists = cameras.Twists();
  output->readouts = cameras.readouts();
}

int64_t FusedSolver::CountInformation() {
  if (num_information_nonzeros_ < 0) {
    const EliminationPlan& plan = schur_->setup().plan;
    num_information_nonzeros_ = NumInformationNonzeros(
        problem_, layout_,
        {plan.num_points(), plan.point.data(), plan.first.data(), plan.image.data()});
  }
  return num_information_nonzeros_;
}

}  // namespace bundle
