#pragma once

#include <chrono>

#include "core/fused/minimize/least_squares.h"
#include "core/fused/minimize/trust_region.h"

namespace bundle::fused {

/// Another LeastSquares, its passes counted and timed in a Minimum.
class Counted final : public LeastSquares {
 public:
  Counted(LeastSquares* problem, Minimum* minimum) : problem_(problem), minimum_(minimum) {}

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
  Candidate TryNewton() override {
    ++minimum_->num_candidates;
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->TryNewton();
  }
  DirectionProducts Products() override {
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->Products();
  }
  Candidate TryCombination(double p, double q) override {
    ++minimum_->num_candidates;
    const Timer timer(&minimum_->candidate_time_in_seconds);
    return problem_->TryCombination(p, q);
  }
  void Accept() override { problem_->Accept(); }
  double StateNorm() const override { return problem_->StateNorm(); }

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
  Minimum* minimum_;
};

}  // namespace bundle::fused
