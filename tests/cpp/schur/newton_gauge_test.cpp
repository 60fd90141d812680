/// Newton directions along free similarities: exact instead of rounding over a damping of 1e-8.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "core/linear/direct_solvers.h"
#include "core/linear/linear_solver.h"
#include "core/model/gauge.h"
#include "core/schur/schur_problem.h"
#include "schur/schur_comparison.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::MakeScene;

constexpr double kDamping = 1e-8;

/// Adds to what LAPACK finds.
class ErringSolver final : public LinearSolver {
 public:
  explicit ErringSolver(const BlockStructure& structure) : exact_(MakeDenseSolver(structure, 1)) {}
  std::vector<double> error;

 private:
  LinearSolution DoFactorize(BlockSystem* system, const std::vector<double>& scale) override {
    return exact_->Factorize(system, scale);
  }
  LinearSolution DoSolve(const double* rhs, int num_rhs, double eta, double* x) override {
    const LinearSolution result = exact_->Solve(rhs, num_rhs, eta, x);
    for (size_t j = 0; j < error.size(); ++j) x[j] += error[j];
    return result;
  }

  const std::unique_ptr<LinearSolver> exact_;
};

struct Found {
  DoglegProducts products;
  Candidate candidate;
};

/// The products of a start, and a combination of the directions; the solver errs along the
/// similarities by these amounts.
Found SolveWithError(const Scene& scene, const SolveOptions& options,
                     const std::vector<double>& amounts) {
  const AdjustmentProblem problem = scene.View();
  const PreparedSolve prepared = Prepare(problem, options, true);
  const BlockStructure structure = Structure(problem, prepared.layout, true);
  ErringSolver solver(structure);
  SchurProblem schur(problem, prepared.layout, options, structure, &solver);
  const std::vector<double> directions = GaugeDirections(problem, prepared.layout, schur.cameras());
  solver.error.assign(directions.size() / kNumGaugeDirections, 0.0);
  for (size_t j = 0; j < solver.error.size(); ++j) {
    for (size_t g = 0; g < amounts.size(); ++g) {
      solver.error[j] += directions[j * kNumGaugeDirections + g] * amounts[g];
    }
  }
  schur.Linearize(kDamping);
  EXPECT_EQ(schur.SolveNewton(0.1).status, LinearStatus::kSuccess);
  Found found;
  found.products = schur.Products();
  found.candidate = schur.EvaluateDoglegStep(-1e-3, 0.7);
  return found;
}

/// Largest relative difference of what a dogleg sees.
double Apart(const Found& a, const Found& b) {
  const auto relative = [](double x, double y) { return std::abs(x - y) / std::abs(y); };
  return std::max(
      {relative(a.products.d_qq, b.products.d_qq), relative(a.products.d_pq, b.products.d_pq),
       relative(a.products.j_qq, b.products.j_qq), relative(a.candidate.cost, b.candidate.cost),
       relative(a.candidate.step_norm, b.candidate.step_norm)});
}

SolveOptions FreeOptions() {
  SolveOptions options = Options();
  options.gauge = Gauge::kNone;
  return options;
}

TEST(NewtonGauge, IsTakenOutOfAFreeWorld) {
  const Scene scene = MakeScene({});
  const SolveOptions options = FreeOptions();
  const Found exact = SolveWithError(scene, options, {});
  for (int g = 0; g < kNumGaugeDirections; ++g) {
    std::vector<double> amounts(kNumGaugeDirections, 0.0);
    amounts[g] = 0.05;
    EXPECT_LT(Apart(SolveWithError(scene, options, amounts), exact), 1e-6) << g;
  }
}

TEST(NewtonGauge, CountsAPointOfSeveralChunksOnce) {
  testing::SceneOptions scene_options;
  scene_options.num_images = 300;
  scene_options.num_points = 40;
  const Scene scene = MakeScene(scene_options);
  const std::vector<double> amounts = {0.05, -0.02, 0.03, 0.01, 0.02, -0.03, 0.04};
  const SolveOptions options = FreeOptions();
  EXPECT_LT(Apart(SolveWithError(scene, options, amounts), SolveWithError(scene, options, {})),
            1e-6);
}

TEST(NewtonGauge, StaysWhereSomethingMayHoldTheWorld) {
  const Scene scene = MakeScene({});
  std::vector<SolveOptions> all(3, FreeOptions());
  all[0].fixed_image_ids = {scene.image_ids[1]};
  all[1].fixed_point_ids = {scene.point_ids[3]};
  all[2].refine_poses = false;
  for (const SolveOptions& options : all) {
    const std::vector<double> amounts = {0.05, 0, 0, 0, 0, 0, 0};
    const double apart =
        Apart(SolveWithError(scene, options, amounts), SolveWithError(scene, options, {}));
    if (options.refine_poses) {
      EXPECT_GT(apart, 1e-3);
    } else {
      EXPECT_EQ(apart, 0);  // no pose has a column
    }
  }
}

TEST(NewtonGauge, OfRigsHasNoScale) {
  testing::SceneOptions scene_options;
  scene_options.num_images = 6;
  Scene scene = MakeScene(scene_options);
  testing::MakeRigs(2, 0.2, false, &scene);
  const SolveOptions options = FreeOptions();
  const Found exact = SolveWithError(scene, options, {});
  EXPECT_LT(Apart(SolveWithError(scene, options, {0.05, -0.02, 0.03, 0.01, 0.02, -0.03}), exact),
            1e-6);
  EXPECT_GT(Apart(SolveWithError(scene, options, {0, 0, 0, 0, 0, 0, 0.05}), exact), 1e-3);
}

}  // namespace
}  // namespace bundle
