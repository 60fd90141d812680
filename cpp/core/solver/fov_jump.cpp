#include "core/solver/fov_jump.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "core/model/fov_lenses.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

constexpr double kNearJump = 1.5e-2;
constexpr double kAtJump = 5e-4;  // where steps into the jump are rejected, if they have to stop

constexpr int SolveSummary::* const kCounts[] = {
    &SolveSummary::num_successful_steps,     &SolveSummary::num_unsuccessful_steps,
    &SolveSummary::num_residual_evaluations, &SolveSummary::num_jacobian_evaluations,
    &SolveSummary::num_linear_solves,
};
constexpr double SolveSummary::* const kTimes[] = {
    &SolveSummary::preprocessor_time_in_seconds,
    &SolveSummary::residual_evaluation_time_in_seconds,
    &SolveSummary::jacobian_evaluation_time_in_seconds,
    &SolveSummary::linear_solver_time_in_seconds,
    &SolveSummary::minimizer_time_in_seconds,
    &SolveSummary::postprocessor_time_in_seconds,
    &SolveSummary::total_time_in_seconds,
};

class SeveralSolves {
 public:
  SeveralSolves(const AdjustmentProblem& problem, const std::vector<int>& lenses,
                const SolveOptions& options, const ProgressCallback& progress,
                const SolveOnce& solve)
      : problem_(problem), lenses_(lenses), options_(options), progress_(progress), solve_(solve) {}

  SolveOutput Run() {
    SolveOptions first = options_;
    if (!Near(problem_).empty()) first.max_num_iterations = 0;
    if (!SolveFrom(problem_, first)) return Finish();
    while (MeetMore()) {
      if (!SolveWith(std::vector<double>(met_.size()))) return Finish();
    }
    if (met_.empty()) return Finish();
    std::vector<double> omegas;
    for (const int lens : met_) omegas.push_back(OmegaBesidePinhole(At(last_), lens, options_));
    SolveWith(omegas);
    return Finish();
  }

 private:
  AdjustmentProblem At(const SolveOutput& state) const {
    AdjustmentProblem view = problem_;
    view.cam_from_world = state.cam_from_world.data();
    view.rig_from_world = state.rig_from_world.data();
    view.sensor_from_rig = state.sensor_from_rig.data();
    view.camera_params = state.camera_params.data();
    view.points = state.points.data();
    state.PutShutters(&view);
    return view;
  }

  std::vector<int> Near(const AdjustmentProblem& view) const {
    std::vector<int> near;
    for (const int lens : lenses_) {
      if (std::abs(OmegaOf(view, lens)) < kNearJump) near.push_back(lens);
    }
    return near;
  }

  /// Records the lenses that are near the discontinuity in the last state; true if there are new
  /// ones.
  bool MeetMore() {
    const size_t before = met_.size();
    for (const int lens : Near(At(last_))) {
      if (std::find(met_.begin(), met_.end(), lens) == met_.end()) met_.push_back(lens);
    }
    return met_.size() > before;
  }

  /// Continues from the last state with other omegas for the lenses near the discontinuity. True if
  /// another solve may follow.
  bool SolveWith(const std::vector<double>& omegas) {
    from_ = std::move(last_);
    for (size_t i = 0; i < omegas.size(); ++i) {
      SetOmega(problem_, met_[i], omegas[i], &from_.camera_params);
    }
    SolveOptions options = options_;
    options.max_num_iterations -= path_.back().iteration;
    if (options.max_num_iterations <= 0) return false;
    try {
      return SolveFrom(At(from_), options);
    } catch (const Interrupted&) {
      was_interrupted_ = true;
      return false;
    }
  }

  bool SolveFrom(const AdjustmentProblem& view, const SolveOptions& options) {
    const bool is_first = path_.empty();
    const IterationRecord before = is_first ? IterationRecord() : path_.back();
    const auto in_sequence = [&before](IterationRecord record) {
      record.iteration += before.iteration;
      record.cumulative_time_in_seconds += before.cumulative_time_in_seconds;
      return record;
    };
    ProgressCallback progress;
    if (progress_) {  // the start of a further solve is not an iteration
      progress = [&](const IterationRecord& record) {
        return (!is_first && record.iteration == 0) || progress_(in_sequence(record));
      };
    }
    last_ = solve_(view, options, progress);
    for (const IterationRecord& record : last_.iterations) {
      if (is_first || record.iteration > 0) path_.push_back(in_sequence(record));
    }
    const SolveSummary& summary = last_.summary;
    if (is_first) {
      total_ = last_;
      factor_costs_before_ = last_.factor_costs_before;
    } else {
      AddToTotal();
    }
    was_interrupted_ = summary.interrupted;
    if (is_first || (summary.is_solution_usable && summary.final_cost < best_.summary.final_cost)) {
      best_ = last_;
      best_path_size_ = path_.size();
    }
    // A solve without iterations only evaluates the start.
    const bool has_ended =
        summary.termination_type == "CONVERGENCE" || options.max_num_iterations == 0;
    return has_ended && summary.is_solution_usable && !summary.interrupted && !path_.empty();
  }

  void AddToTotal() {
    const SolveSummary& more = last_.summary;
    --total_.summary.num_successful_steps;  // the start of a further solve is not a step
    for (const auto count : kCounts) total_.summary.*count += std::max(more.*count, 0);
    for (const auto time : kTimes) total_.summary.*time += std::max(more.*time, 0.0);
    total_.build_time_in_seconds += last_.build_time_in_seconds;
    total_.solve_time_in_seconds += last_.solve_time_in_seconds;
  }

  /// The best state, with the iterations that led to it and the total counts and times.
  SolveOutput Finish() {
    if (met_.empty() && best_path_size_ == path_.size()) return std::move(best_);
    SolveOutput result = std::move(best_);
    SolveSummary& summary = result.summary;
    const bool is_start = best_path_size_ == 1 && path_.size() > 1;
    if (is_start) {
      summary.termination_type = last_.summary.termination_type;
      summary.message = last_.summary.message;
    }
    path_.resize(best_path_size_);
    result.iterations = std::move(path_);
    result.factor_costs_before = std::move(factor_costs_before_);
    result.build_time_in_seconds = total_.build_time_in_seconds;
    result.solve_time_in_seconds = total_.solve_time_in_seconds;
    summary.initial_cost = total_.summary.initial_cost;
    summary.interrupted = was_interrupted_;
    for (const auto count : kCounts) summary.*count = total_.summary.*count;
    for (const auto time : kTimes) summary.*time = total_.summary.*time;
    Warn(WarningKind::kFormulaJump, Describe(At(result)), &summary.warnings);
    return result;
  }

  std::string Describe(const AdjustmentProblem& solution) const {
    constexpr size_t kNamed = 5;
    std::ostringstream text;
    text << "COLMAP's formula of FOV jumps at an omega of " << kFovJump << ": ";
    for (size_t i = 0; i < std::min(met_.size(), kNamed); ++i) {
      const double omega = std::abs(OmegaOf(solution, met_[i]));
      text << (i == 0 ? "" : "; ") << "camera " << problem_.camera_ids[met_[i]];
      if (omega == 0) {
        text << " fits best as a pinhole (omega 0)";
      } else if (std::abs(omega - kFovJump) < kAtJump) {
        text << " ended at the jump, below the cost of a pinhole but not at a minimum";
      } else {
        text << (omega < kFovJump ? " has a minimum below the jump, at omega "
                                  : " was moved across the jump, to omega ")
             << OmegaOf(solution, met_[i]);
      }
    }
    if (met_.size() > kNamed) text << "; and " << met_.size() - kNamed << " more";
    text << ".";
    return text.str();
  }

  const AdjustmentProblem& problem_;
  const std::vector<int>& lenses_;
  const SolveOptions& options_;
  const ProgressCallback& progress_;
  const SolveOnce& solve_;
  std::vector<int> met_;  ///< lenses near the discontinuity at the start, or after a solve
  SolveOutput from_, last_;
  SolveRecord total_;  ///< record of the first solve, with the counts and times of all
  std::vector<double> factor_costs_before_;
  SolveOutput best_;
  std::vector<IterationRecord> path_;  ///< iterations of all solves, in sequence
  size_t best_path_size_ = 0;          ///< number of iterations up to the best state
  bool was_interrupted_ = false;
};

}  // namespace

SolveOutput SolveBeyondFovJump(const AdjustmentProblem& problem, const std::vector<int>& lenses,
                               const SolveOptions& options, const ProgressCallback& progress,
                               const SolveOnce& solve) {
  if (lenses.empty() || options.max_num_iterations == 0) return solve(problem, options, progress);
  return SeveralSolves(problem, lenses, options, progress, solve).Run();
}

}  // namespace bundle
