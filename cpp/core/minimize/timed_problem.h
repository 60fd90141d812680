#pragma once

/// Numbers and times of the passes of a solve. Included only by trust_region.cpp.

#include <chrono>

#include "core/minimize/least_squares.h"
#include "core/minimize/trust_region.h"

namespace bundle {

/// Decorator of a LeastSquares that counts and times its passes in a MinimizerSummary.
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
  std::optional<double> DegreesOfFreedom() const override { return problem_->DegreesOfFreedom(); }
  bool HasDecrement() const override { return problem_->HasDecrement(); }
  NewtonDecrement Decrement() override {
    const Timer timer(&minimum_->solve_time_in_seconds);
    return problem_->Decrement();
  }
  double CostOfAll() override { return problem_->CostOfAll(); }
  void KeepPrevious() override { problem_->KeepPrevious(); }
  void ReturnToKept() override { problem_->ReturnToKept(); }
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

  /// Adds the seconds of its lifetime.
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

}  // namespace bundle
