#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/minimize/least_squares.h"

namespace bundle {

struct MinimizerSummary {
  bool HasConverged() const { return termination_type == "CONVERGENCE"; }

  std::string termination_type;  ///< CONVERGENCE, NO_CONVERGENCE, FAILURE or USER_SUCCESS
  std::string message;
  bool interrupted = false;
  double untaken_decrease = 0;  ///< SolveSummary::untaken_decrease
  int num_successful_steps = 0;
  int num_unsuccessful_steps = 0;
  int num_linear_solves = 0;
  int num_linearizations = 0;
  int num_candidates = 0;
  double linearization_time_in_seconds = 0;  ///< Linearize
  double solve_time_in_seconds = 0;          ///< SolveNewton
  double candidate_time_in_seconds = 0;      ///< all passes that evaluate steps
  std::vector<IterationRecord> iterations;   ///< costs without `fixed_cost` of the problem
};

/// Minimises as ceres::internal::TrustRegionMinimizer does, step by step: same strategies, same
/// radius, same three stopping tests. The state of `problem` is the best one at the end.
///
/// `before`: what led to the state that `problem` has, where this goes on from there after other
/// residuals count. Everything begins anew, but the iterations follow those of before, the first
/// being the evaluation of the state, and `options` are for all of them.
MinimizerSummary Minimize(const SolveOptions& options, const ProgressCallback& progress,
                          LeastSquares* problem, MinimizerSummary before = {});

/// Another LeastSquares, its passes counted and timed in a MinimizerSummary.
class TimedProblem final : public LeastSquares {
 public:
  TimedProblem(LeastSquares* problem, MinimizerSummary* minimum)
      : problem_(problem), minimum_(minimum) {}

  Linearization Linearize(double damping) override {
    ++minimum_->num_linearizations;
    const Timer timer(&minimum_->linearization_time_in_seconds);
    return problem_->Linearize(damping);
  }
  NewtonResult SolveNewton(double eta) override {
    ++minimum_->num_linear_solves;
    const Timer timer(&minimum_->solve_time_in_seconds);
    return problem_->SolveNewton(eta);
  }
  Candidate EvaluateNewtonStep() override {
    ++minimum_->num_candidates;
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->EvaluateNewtonStep();
  }
  DoglegProducts Products() override {
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->Products();
  }
  Candidate EvaluateDoglegStep(double p, double q) override {
    ++minimum_->num_candidates;
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->EvaluateDoglegStep(p, q);
  }
  void Accept() override { problem_->Accept(); }
  double StateNorm() const override { return problem_->StateNorm(); }
  bool HasBounds() const override { return problem_->HasBounds(); }
  StepLine LineAlongStep() override {
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->LineAlongStep();
  }
  Candidate EvaluateAlongStep(double a) override {
    ++minimum_->num_candidates;
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->EvaluateAlongStep(a);
  }
  double SlopeAtCandidate() override {
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->SlopeAtCandidate();
  }

 private:
  using Clock = std::chrono::steady_clock;

  /// Adds the seconds that it lives.
  class Timer {
   public:
    explicit Timer(double* seconds) : seconds_(seconds) {}
    ~Timer() { *seconds_ += std::chrono::duration<double>(Clock::now() - start_).count(); }
    Timer(const Timer&) = delete;
    Timer& operator=(const Timer&) = delete;

   private:
    double* seconds_;
    Clock::time_point start_ = Clock::now();
  };

  LeastSquares* problem_;
  MinimizerSummary* minimum_;
};

/// Shortens a step whose projection onto the bounds does not lower the cost enough. `cost`: at x,
/// with what is held.
/// `candidate` is that of the whole step; where a shorter one was found it becomes that one's, with
/// the model cost change of the whole step. The candidate of `problem` follows.
void SearchAlongStep(double cost, LeastSquares* problem, Candidate* candidate);

}  // namespace bundle
