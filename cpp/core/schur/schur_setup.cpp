#include "core/schur/schur_setup.h"

#include <algorithm>
#include <utility>

namespace bundle::fused {

SchurSetup::SchurSetup(const ProblemView& of_problem, const ParameterLayout& of_layout,
                       const SolveOptions& options, BlockStructure of_structure)
    : problem(of_problem),
      layout(of_layout),
      structure(std::move(of_structure)),
      kernels(SelectKernels()),
      groups(GroupImages(problem, layout)),
      plan(PlanPoints(problem, layout, groups.block_size() * static_cast<int>(sizeof(double)),
                      options.num_threads)),
      input(MakeInput(options, plan)),
      assembler(problem, layout, groups.groups, groups.image_group, structure) {}

EliminationInput SchurSetup::MakeInput(const SolveOptions& options,
                                       const EliminationPlan& points) const {
  EliminationInput result;
  result.plan = &points;
  result.groups = groups.groups.data();
  result.num_groups = static_cast<int>(groups.groups.size());
  result.image_group = groups.image_group.data();
  result.image_columns = groups.image_columns.data();
  result.image_quads = groups.image_quads.data();
  result.image_refined = groups.image_refined.data();
  result.num_columns = groups.num_columns();
  result.num_rows = groups.num_rows;
  result.mixed = groups.mixed();
  result.cheirality = options.cheirality;
  result.loss = options.loss;
  result.loss_scale = options.loss_scale;
  for (int p = 0; p < points.num_points(); ++p) {
    result.longest_track = std::max(result.longest_track, points.first[p + 1] - points.first[p]);
  }
  return result;
}

double SchurSetup::FixedCost(const SolveOptions& options) const {
  if (plan.num_observations() == problem.num_observations) return 0;
  const EliminationPlan fixed = PlanFixedPoints(problem, layout, options.num_threads);
  const EliminationInput fixed_input = MakeInput(options, fixed);
  const State state(problem, layout, fixed);
  double cost = 0;
  for (const Chunk& chunk : fixed.chunks) cost += kernels.cost(fixed_input, state.records(), chunk);
  return cost;
}

}  // namespace bundle::fused
