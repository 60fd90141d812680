#include "core/schur/schur_setup.h"

#include <algorithm>
#include <utility>

#include "core/model/gauge.h"
#include "core/schur/sort_points.h"

namespace bundle {

static_assert(BlockSystem::kMaxBlockSize == ColumnMap::kMaxSize);
static_assert(BlockSystem::kNumGaugeDirections == kNumGaugeDirections);

namespace {

const double* SigmasOf(const EliminationPlan& plan) {
  return plan.inverse_sigma.empty() ? nullptr : plan.inverse_sigma.data();
}

// With fewer columns, conjugate gradients end before they amplify rounding errors much. Without a
// grid, they keep the digits that a grid costs.
constexpr int kColumnsWorthAGrid = 100;

// Average number of blocks in a block column of S. Streets and orbits have 20 to 30, photo
// collections 80 and more.
constexpr int64_t kMostBlocksForSections = 48;

}  // namespace

SumOrder ChooseSumOrder(LinearSolverType solver, int num_columns, int64_t num_block_columns,
                        int64_t num_blocks, bool has_maps, bool is_implicit) {
  const bool is_iterative = solver == LinearSolverType::kIterativeSchur && !is_implicit;
  if (is_iterative && num_columns >= kColumnsWorthAGrid && !has_maps) return SumOrder::kGrid;
  // The columns of a dense S have the order of the images.
  const bool has_order_of_images = solver == LinearSolverType::kDenseSchur;
  const bool is_scattered = num_blocks > kMostBlocksForSections * num_block_columns;
  return has_order_of_images || !is_scattered ? SumOrder::kSections : SumOrder::kChunks;
}

SchurSetup::SchurSetup(const AdjustmentProblem& of_problem, const ParameterLayout& of_layout,
                       const SolveOptions& options, BlockStructure of_structure, bool is_reused,
                       bool is_implicit, ThreadPool* pool)
    : problem(of_problem),
      layout(of_layout),
      structure(std::move(of_structure)),
      kernels(SelectKernels()),
      parts(problem, layout),
      assembler(problem, layout, parts, kernels, structure),
      sums(ChooseSumOrder(options.linear_solver_type, structure.num_columns(),
                          structure.num_blocks(), static_cast<int64_t>(structure.row_block.size()),
                          assembler.has_maps(), is_implicit)),
      plan(PlanPoints(problem, layout, parts, pool, is_reused, sums == SumOrder::kSections,
                      /*has_pairs=*/!is_implicit)),
      input(MakeInput(options, plan)),
      is_reused_(is_reused),
      pool_(pool) {
  const bool has_error_terms = sums == SumOrder::kSections;
  if (layout.HasHardTwists() && !is_implicit) {
    part_sums = std::make_unique<PartSums>(problem, layout, parts, kernels, plan, structure,
                                           assembler, has_error_terms);
  } else if (has_error_terms) {
    assembler.PlaceErrorTerms();
  }
}

EliminationInput SchurSetup::MakeInput(const SolveOptions& options,
                                       const EliminationPlan& points) const {
  EliminationInput result;
  result.plan = &points;
  result.groups = parts.groups().data();
  result.num_groups = static_cast<int>(parts.groups().size());
  result.image_group = parts.image_group().data();
  result.image_refined = parts.image_refined().data();
  result.part_rows = parts.part_rows().data();
  result.part_quads = parts.part_quads().data();
  result.own_quads = parts.own_quads();
  result.camera_quads = parts.camera_quads();
  result.record_columns = parts.record_columns();
  result.part_columns = parts.part_columns();
  result.cheirality = options.cheirality;
  result.loss = options.loss;
  result.loss_scale = options.loss_scale;
  result.inverse_sigma = SigmasOf(points);
  for (int p = 0; p < points.num_points(); ++p) {
    result.longest_track = std::max(result.longest_track, points.first[p + 1] - points.first[p]);
  }
  return result;
}

void SchurSetup::Reset(const SolveOptions& options) {
  const auto reset = [&](EliminationPlan* points, EliminationInput* with) {
    TakeMeasurements(problem, points);
    with->loss = options.loss;
    with->loss_scale = options.loss_scale;
    with->inverse_sigma = SigmasOf(*points);
  };
  reset(&plan, &input);
  if (fixed_ == nullptr) return;
  reset(&fixed_->plan, &fixed_->input);
  fixed_->state.Reset(layout, fixed_->plan);
}

DoubleDouble SchurSetup::FixedCost(const SolveOptions& options) {
  if (plan.num_observations() == problem.num_observations) return {};
  if (fixed_ == nullptr) {
    EliminationPlan fixed = PlanFixedPoints(problem, layout, parts, pool_, is_reused_);
    State state(problem, layout, fixed);
    fixed_ = std::make_unique<FixedObservations>(
        FixedObservations{std::move(fixed), {}, std::move(state)});
    fixed_->input = MakeInput(options, fixed_->plan);
  }
  DoubleDouble cost;
  for (const Chunk& chunk : fixed_->plan.chunks) {
    cost.Add(kernels.cost(fixed_->input, fixed_->state.records(), chunk));
  }
  if (!is_reused_) fixed_.reset();
  return cost;
}

}  // namespace bundle
