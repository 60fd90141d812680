#pragma once

#include <memory>
#include <vector>

#include "core/interface/options.h"
#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/minimize/least_squares.h"
#include "core/model/parameter_layout.h"
#include "core/problem/problem_view.h"

namespace bundle::fused {

class CameraFactors;

/// Bundle adjustment with the points eliminated: a LeastSquares made of passes over the points.
class SchurProblem final : public LeastSquares {
 public:
  /// Keeps references to the problem, the layout and the solver. `structure` is that of the solver.
  /// `is_reused`: Reset will be called.
  SchurProblem(const ProblemView& problem, const ParameterLayout& layout,
               const SolveOptions& options, BlockStructure structure, LinearSolver* solver,
               bool is_reused = false);
  ~SchurProblem() override;

  /// Starts anew at the problem's values (poses, camera parameters, points, measurements) and with
  /// the options' loss, after any of these changed. Every bit is that of a new SchurProblem.
  void Reset(const SolveOptions& options);

  Linearization Linearize(double damping) override;
  NewtonResult SolveNewton(double eta) override;
  Candidate EvaluateNewtonStep() override;
  DoglegProducts Products() override;
  Candidate EvaluateDoglegStep(double a, double b) override;
  void Accept() override;
  double StateNorm() const override;
  bool HasBounds() const override;
  StepLine LineAlongStep() override;
  Candidate EvaluateAlongStep(double a) override;
  double SlopeAtCandidate() override;

  /// Observations that reach the solver: those with something to refine.
  int64_t num_active_observations() const;
  /// Cost of the others, and of factors with nothing to refine; not part of Linearization::cost.
  double fixed_cost() const;
  /// Those beside the observations.
  const CameraFactors& factors() const;
  /// The name of the instruction set that its kernels were compiled for: "baseline", "avx2+fma",
  /// "avx512".
  const char* instruction_set() const;

  /// Observations that do not count at the state but hold a residual (factors/reprojection.h).
  int64_t num_held() const;

  /// Frees S, which can be most of its memory, after the last linearisation.
  void FreeSystem();

  /// Camera side and points (as in ProblemView) at the state.
  const CameraStates& cameras() const;
  std::vector<double> Points() const;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace bundle::fused
