/// Trials on scripted problems: a state is a number, its cost and its steps are given.

#include "core/pose_graph/gauss_newton_trial.h"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>
#include <vector>

#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

constexpr int kNoStep = -1;

struct State {
  double cost;
  int next;         ///< state that a step without damping leads to
  int next_damped;  ///< with damping above 1e-9
};

/// Takes the scripted steps, all of them predicted to lower the cost by 1.
class ScriptedProblem final : public PoseGraphProblem {
 public:
  explicit ScriptedProblem(std::vector<State> states) : states_(std::move(states)) {}

  Linearization Linearize(double damping) override {
    damping_ = damping;
    if (interrupted_at == x_) throw Interrupted();
    linearized.push_back(x_);
    return {true, Now().cost, 0, 1, 1};
  }
  NewtonResult SolveNewton(double /*eta*/) override {
    solved.push_back(x_);
    next_ = damping_ > 1e-9 ? Now().next_damped : Now().next;
    return {next_ == kNoStep ? LinearStatus::kFailure : LinearStatus::kSuccess, 1, ""};
  }
  Candidate EvaluateNewtonStep() override {
    candidate_ = next_;
    Candidate candidate;
    candidate.model_cost_change = candidate.step_norm = 1;
    candidate.cost = states_[candidate_].cost;
    return candidate;
  }
  void Accept() override { std::swap(x_, candidate_); }
  double StateNorm() const override { return 1; }
  const std::vector<double>& poses() const override { return poses_ = {double(x_)}; }
  void Restore(const std::vector<double>& poses) override { x_ = static_cast<int>(poses[0]); }

  std::vector<double> Chi2() const override { throw std::logic_error("not scripted"); }
  double fixed_cost() const override { return 0; }
  int num_free_poses() const override { return 1; }
  int64_t num_active_edges() const override { return 1; }
  const BlockStructure& structure() const override { throw std::logic_error("not scripted"); }
  const std::vector<int>& pose_of_blocks() const override {
    throw std::logic_error("not scripted");
  }
  BlockSystem& system() override { throw std::logic_error("not scripted"); }
  LinearSolver& solver() override { throw std::logic_error("not scripted"); }
  FactorStatistics factor_statistics() const override { return {}; }
  double symbolic_time_in_seconds() const override { return 0; }
  DoglegProducts Products() override { return {}; }
  Candidate EvaluateDoglegStep(double /*a*/, double /*b*/) override { return {}; }

  int x() const { return x_; }

  int interrupted_at = -1;
  std::vector<int> linearized, solved;  ///< states of the calls

 private:
  const State& Now() const { return states_[x_]; }

  const std::vector<State> states_;
  int x_ = 0, candidate_ = 0, next_ = 0;
  double damping_ = 0;
  mutable std::vector<double> poses_;
};

SolveOptions GaussNewton() {
  SolveOptions options;
  options.trust_region_strategy_type = TrustRegionStrategy::kLevenbergMarquardt;
  options.initial_trust_region_radius = options.max_trust_region_radius = 1e16;
  options.gradient_tolerance = options.parameter_tolerance = 0;
  options.function_tolerance = 1e-12;
  options.max_num_iterations = 50;
  return options;
}

std::vector<bool> Successes(const MinimizerSummary& minimum) {
  std::vector<bool> successes;
  for (const IterationRecord& record : minimum.iterations) {
    successes.push_back(record.step_is_successful);
  }
  return successes;
}

TEST(GaussNewtonTrial, GoesOnFromTheRejectedStepWithoutTakingItAgain) {
  ScriptedProblem problem({{10, 1, 1}, {40, 2, 2}, {9, 3, 3}, {8, 3, 3}});
  const MinimizerSummary minimum = MinimizePoseGraph(GaussNewton(), nullptr, &problem);
  EXPECT_EQ(problem.x(), 3);
  EXPECT_EQ(minimum.termination_type, "CONVERGENCE");
  EXPECT_FALSE(minimum.interrupted);
  EXPECT_EQ(problem.solved, (std::vector<int>{0, 1, 2, 3}));
  EXPECT_EQ(problem.linearized, (std::vector<int>{0, 1, 2, 3}));
  EXPECT_EQ(Successes(minimum), (std::vector<bool>{true, false, false, true, true}));
  EXPECT_EQ(minimum.num_successful_steps, 3);
  EXPECT_EQ(minimum.num_unsuccessful_steps, 2);
  EXPECT_EQ(minimum.iterations[3].cost_change, 1);  // since before the trial
  EXPECT_EQ(minimum.iterations[4].cost_change, 1);
}

TEST(GaussNewtonTrial, ReturnsAfterAFewStepsAndContinuesWithDamping) {
  std::vector<State> states = {{10, 1, 30}};
  for (int k = 1; k < 30; ++k) states.push_back({20.0 + k, k + 1, k + 1});
  states.push_back({9, 30, 30});
  ScriptedProblem problem(states);
  const MinimizerSummary minimum = MinimizePoseGraph(GaussNewton(), nullptr, &problem);
  EXPECT_EQ(problem.x(), 30);
  EXPECT_EQ(minimum.termination_type, "CONVERGENCE");
  EXPECT_EQ(problem.solved, (std::vector<int>{0, 1, 2, 3, 4, 0, 30}));
}

TEST(GaussNewtonTrial, EndsByACostThatIsLowerByMoreThanRounding) {
  ScriptedProblem problem({{10, 1, 3}, {40, 2, 2}, {10 * (1 - 1e-7), 2, 2}, {9, 3, 3}});
  MinimizePoseGraph(GaussNewton(), nullptr, &problem);
  EXPECT_EQ(problem.x(), 3);
}

TEST(GaussNewtonTrial, StaysWhereNoStepCanBeSolved) {
  ScriptedProblem problem({{10, 1, 1}, {9, kNoStep, kNoStep}});
  const MinimizerSummary minimum = MinimizePoseGraph(GaussNewton(), nullptr, &problem);
  EXPECT_EQ(problem.x(), 1);
  EXPECT_EQ(minimum.termination_type, "FAILURE");
  for (size_t k = 1; k < problem.solved.size(); ++k) EXPECT_EQ(problem.solved[k], 1);
}

TEST(GaussNewtonTrial, KeepsTheBestStateIfItIsInterrupted) {
  ScriptedProblem problem({{10, 1, 1}, {40, 2, 2}, {9, 2, 2}});
  problem.interrupted_at = 1;
  const MinimizerSummary minimum = MinimizePoseGraph(GaussNewton(), nullptr, &problem);
  EXPECT_TRUE(minimum.interrupted);
  EXPECT_EQ(problem.x(), 0);
  EXPECT_EQ(minimum.iterations.size(), 2U);
  problem.interrupted_at = 0;
  EXPECT_THROW(MinimizePoseGraph(GaussNewton(), nullptr, &problem), Interrupted);
}

TEST(GaussNewtonTrial, TriesAgainAfterATrialThatSucceeded) {
  ScriptedProblem problem({{10, 1, 1}, {40, 2, 2}, {9, 3, 3}, {50, 4, 4}, {8, 4, 4}});
  const MinimizerSummary minimum = MinimizePoseGraph(GaussNewton(), nullptr, &problem);
  EXPECT_EQ(problem.x(), 4);
  EXPECT_EQ(problem.solved, (std::vector<int>{0, 1, 2, 3, 4}));
  EXPECT_EQ(minimum.num_successful_steps, 3);
}

}  // namespace
}  // namespace bundle
