#include "core/solver/pose_graph_solver.h"

/// Units. A solve runs with information whose rotations are about 1: all roots are multiplied by a
/// power of two, 2^-k, and so are the scales of losses. Losses are homogeneous, rho_c(x) = c^2
/// rho_1(x / c^2). So chi2, costs and gradients are multiplied by 4^-k, steps stay the same, and
/// the floor of the damping, the overflow of squares and the gradient tolerance (by Ceres'
/// conventions absolute numbers) do not depend on the unit of the information. All results are
/// multiplied back.
///
/// Nor do they depend on the unit of length. With translations of information about u, lengths have
/// a natural unit L = u^-1/2, in which their gradient is that by the length times L. The tolerance
/// is multiplied by min(1, u^1/2), which holds it in both units.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>

#include "core/ceres/solve_graph.h"
#include "core/checking/check_solution.h"
#include "core/error.h"
#include "core/pose_graph/gauss_newton_trial.h"
#include "core/pose_graph/pose_edge_factor.h"
#include "core/pose_graph/pose_graph_problem.h"
#include "core/solver/summarize_fused.h"

namespace bundle {
namespace {

SolveSummary SummarizePoseGraph(const PoseGraph& graph, const PoseGraphProblem& problem,
                                const SolveOptions& options, const MinimizerSummary& minimum) {
  SolveSummary result;
  const int tangent = TangentSize(graph.dimension());
  const int ambient = AmbientSize(graph.dimension());
  SummarizeChoices(options, &result);
  SummarizeMinimum(minimum, problem.fixed_cost(), Counted::kAccepted, &result);
  SetSizes(problem.num_free_poses(), ambient * problem.num_free_poses(), problem.num_active_edges(),
           tangent * problem.num_active_edges(), &result);
  result.linear_solver_type_used = "SPARSE_NORMAL_CHOLESKY";
  result.linear_solver_ordering_given = {problem.num_free_poses()};
  result.linear_solver_ordering_used = {problem.num_free_poses()};
  result.sparse_linear_algebra_library_type = "SUPERNODAL";
  result.factor = SummarizeFactor(problem.structure(), problem.factor_statistics(),
                                  problem.symbolic_time_in_seconds());
  result.num_information_nonzeros = result.factor.num_reduced_nonzeros.value_or(-1);
  result.backend_used = UpperName(Backend::kFused, kBackends);
  return result;
}

void SolveByNormalEquations(const PoseGraph& graph, const SolveOptions& options,
                            const std::string& ordering, const FillOrdering* known,
                            bool with_trials, const ProgressCallback& progress,
                            PoseGraphOutput* output) {
  const Stopwatch setup;
  const std::unique_ptr<PoseGraphProblem> problem =
      MakePoseGraphProblem(graph, ordering, options.num_threads, known);
  const double fixed_cost = problem->fixed_cost();
  ProgressCallback report;
  if (progress) {
    report = [&progress, fixed_cost](IterationRecord record) {
      record.cost += fixed_cost;
      return progress(record);
    };
  }
  const double setup_time = setup.seconds();
  const Stopwatch minimizer;
  MinimizerSummary minimum = with_trials ? MinimizePoseGraph(options, report, problem.get())
                                         : Minimize(options, report, problem.get());
  output->summary = SummarizePoseGraph(graph, *problem, options, minimum);
  output->summary.preprocessor_time_in_seconds = setup_time;
  output->summary.minimizer_time_in_seconds = minimizer.seconds();
  output->summary.postprocessor_time_in_seconds = 0;
  output->summary.total_time_in_seconds = setup.seconds();
  output->solve_time_in_seconds = setup.seconds();
  output->iterations = std::move(minimum.iterations);
  for (IterationRecord& record : output->iterations) record.cost += fixed_cost;
  JudgeEnd(/*has_bounds=*/false, options.function_tolerance, output);
  output->poses = problem->poses();
  output->chi2_after = problem->Chi2();
}

template <typename Group>
void SolveByCeres(const PoseGraph& graph, const SolveOptions& options,
                  const ProgressCallback& progress, PoseGraphOutput* output) {
  FactorGraph factors;
  for (int64_t i = 0; i < graph.num_poses(); ++i) {
    Block block{
        "pose " + std::to_string(i), Retraction(Group::kManifold, Group::kAmbient), {}, {}, {}, {}};
    const double* const pose = graph.poses.data() + i * Group::kAmbient;
    block.value.assign(pose, pose + Group::kAmbient);
    if (graph.held[i] != 0) block.held.assign(Group::kTangent, true);
    factors.blocks.push_back(std::move(block));
  }
  for (int64_t e = 0; e < graph.num_edges(); ++e) {
    factors.factors.push_back(std::make_unique<PoseEdgeFactor<Group>>(graph, e));
  }
  GraphOutput solved = SolveGraph(factors, options, progress);
  static_cast<SolveRecord&>(*output) = std::move(static_cast<SolveRecord&>(solved));
  for (const std::vector<double>& value : solved.values) {
    output->poses.insert(output->poses.end(), value.begin(), value.end());
  }
}

/// A graph without free poses.
void ReportNothingToRefine(const SolveOptions& options, double cost, PoseGraphOutput* output) {
  SolveSummary& summary = output->summary;
  summary.initial_cost = summary.final_cost = summary.fixed_cost = cost;
  summary.termination_type = "CONVERGENCE";
  summary.message = "Function tolerance reached. No non-constant parameter blocks found.";
  summary.is_solution_usable = true;
  summary.num_successful_steps = 1;  // the start, which Ceres counts as successful
  summary.num_unsuccessful_steps = 0;
  for (int* size :
       {&summary.num_parameter_blocks, &summary.num_parameters, &summary.num_residual_blocks,
        &summary.num_residuals, &summary.num_parameter_blocks_reduced,
        &summary.num_parameters_reduced, &summary.num_residual_blocks_reduced,
        &summary.num_residuals_reduced, &summary.num_linear_solves}) {
    *size = 0;
  }
  summary.linear_solver_type_used = summary.linear_solver_type_given = "SPARSE_NORMAL_CHOLESKY";
  summary.trust_region_strategy_type = "LEVENBERG_MARQUARDT";
  summary.dogleg_type = "TRADITIONAL_DOGLEG";
  summary.num_threads_given = summary.num_threads_used = options.num_threads;
  summary.total_time_in_seconds = 0;
  summary.backend_used = UpperName(Backend::kFused, kBackends);
  IterationRecord start;
  start.cost = cost;
  start.step_is_successful = true;
  output->iterations.push_back(start);
}

/// A cost or a difference of costs in the caller's unit. The largest number stands for infinity.
void Multiply(double unit, double* cost) {
  constexpr double kMost = std::numeric_limits<double>::max();
  if (std::abs(*cost) < kMost) *cost = std::clamp(unit * *cost, -kMost, kMost);
}

IterationRecord InUnit(double unit, IterationRecord record) {
  for (double* value : {&record.cost, &record.cost_change, &record.gradient_max_norm}) {
    Multiply(unit, value);
  }
  return record;
}

void MultiplyOutput(double unit, PoseGraphOutput* output) {
  SolveSummary& summary = output->summary;
  for (double* value : {&summary.initial_cost, &summary.final_cost, &summary.fixed_cost,
                        &summary.held_cost, &summary.untaken_decrease}) {
    if (*value != -1) Multiply(unit, value);  // unset
  }
  for (IterationRecord& record : output->iterations) record = InUnit(unit, record);
  for (double& of_edge : output->chi2_after) Multiply(unit, &of_edge);
  for (double& of_edge : output->chi2_before) Multiply(unit, &of_edge);
}

}  // namespace

PoseGraphOutput SolvePoseGraph(const PoseGraphView& view, const PoseErrorOptions& errors,
                               const SolveOptions& given, const std::string& ordering,
                               const ProgressCallback& in_units, const FillOrdering* known,
                               bool with_trials, const double* chi2) {
  const Stopwatch time;
  SolveOptions options = given;
  options.num_threads = EffectiveNumThreads(options.num_threads);
  if (options.backend == Backend::kCeres && errors.loss.kind != EdgeLoss::Kind::kOfFactors) {
    throw InputError("backend: expected auto or fused with this loss, found ceres");
  }
  PoseGraph graph = MakePoseGraph(view, errors);
  const RootExponents exponents = ExponentsOfRoots(*graph.prepared);
  const double unit = std::ldexp(1.0, 2 * exponents.rotation);
  graph.prepared = ScaledEdges(*graph.prepared, -exponents.rotation);
  graph.errors.loss_scale = std::ldexp(errors.loss_scale, -exponents.rotation);
  const int of_translation = std::min(exponents.translation - exponents.rotation, 0);
  options.gradient_tolerance = std::ldexp(options.gradient_tolerance, of_translation);
  ProgressCallback progress;
  if (in_units) {
    progress = [&in_units, unit](const IterationRecord& record) {
      return in_units(InUnit(unit, record));
    };
  }
  PoseGraphOutput output;
  if (chi2 == nullptr) {
    output.chi2_before = EdgeChi2(graph, graph.poses);
  } else {
    output.chi2_before.assign(chi2, chi2 + graph.num_edges());
    for (double& of_edge : output.chi2_before) of_edge /= unit;
  }
  const bool any_free =
      std::any_of(graph.held.begin(), graph.held.end(), [](uint8_t held) { return held == 0; });
  if (!any_free) {
    double cost = 0;
    for (const double of_edge : output.chi2_before) cost += 0.5 * of_edge;
    output.poses = graph.poses;
    ReportNothingToRefine(options, cost, &output);
  } else if (options.backend != Backend::kCeres) {
    SolveByNormalEquations(graph, options, ordering, known, with_trials, progress, &output);
  } else if (graph.dimension() == 2) {
    SolveByCeres<Se2>(graph, options, progress, &output);
  } else {
    SolveByCeres<Se3>(graph, options, progress, &output);
  }
  output.summary.backend_given = UpperName(given.backend, kBackends);
  if (given.backend == Backend::kAuto) {
    output.summary.backend_choice = "Pose graphs have normal equations of their own.";
  }
  if (output.chi2_after.empty()) output.chi2_after = EdgeChi2(graph, output.poses);
  output.weights = EdgeWeights(graph, output.chi2_after);
  MultiplyOutput(unit, &output);
  const int n = view.ambient();
  for (int64_t i = 0; i < view.num_poses; ++i) {
    if (graph.held[i] != 0) std::copy_n(view.poses + i * n, n, output.poses.begin() + i * n);
  }
  output.build_time_in_seconds = time.seconds() - output.solve_time_in_seconds;
  return output;
}

}  // namespace bundle
