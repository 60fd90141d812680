#include <gtest/gtest.h>

#include "core/error.h"
#include "core/schur/elimination_plan.h"
#include "core/solver/solver.h"
#include "support/scene.h"

namespace bundle {
namespace {

PreparedSolve Prepare(const SolveOptions& options) {
  testing::SceneOptions small;
  small.num_images = 3;
  small.num_points = 8;
  return PrepareSolve(testing::MakeScene(small).View(), options);
}

/// The result where the backend is left open; asked for, the fused one agrees or throws.
Backend Choose(SolveOptions options, const PreparedSolve& prepared) {
  const Backend chosen = ChooseBackend(options, prepared).backend;
  options.backend = Backend::kFused;
  if (chosen == Backend::kFused) {
    EXPECT_EQ(ChooseBackend(options, prepared).backend, Backend::kFused);
  } else {
    EXPECT_THROW(ChooseBackend(options, prepared), InputError);
  }
  return chosen;
}

TEST(ChooseBackend, TheLongestTrackIsTakenAndNoLonger) {
  const SolveOptions options;
  PreparedSolve prepared = Prepare(options);
  prepared.longest_track = kMaxTrackLength;
  EXPECT_EQ(Choose(options, prepared), Backend::kFused);
  ++prepared.longest_track;
  EXPECT_EQ(Choose(options, prepared), Backend::kCeres);
}

TEST(ChooseBackend, SomethingBesidePointsIsRefined) {
  SolveOptions options;
  EXPECT_EQ(Choose(options, Prepare(options)), Backend::kFused);
  options.refine_points = false;
  EXPECT_EQ(Choose(options, Prepare(options)), Backend::kFused);
  options.refine_points = true;
  options.refine_poses = options.refine_focal = options.refine_extra = false;
  EXPECT_EQ(Choose(options, Prepare(options)), Backend::kCeres);
}

TEST(ChooseBackend, APreconditionerCountsWhereConjugateGradientsMayRun) {
  SolveOptions options;
  options.preconditioner_type = PreconditionerType::kClusterJacobi;
  for (const LinearSolverType type : {LinearSolverType::kAuto, LinearSolverType::kIterativeSchur}) {
    options.linear_solver_type = type;
    EXPECT_EQ(Choose(options, Prepare(options)), Backend::kCeres);
  }
  options.linear_solver_type = LinearSolverType::kDenseSchur;
  EXPECT_EQ(Choose(options, Prepare(options)), Backend::kFused);
}

/// For any problem: the sentence of the choice, and none where the choice is not by the options.
TEST(ReasonForCeres, IsThatOfTheChoice) {
  SolveOptions options;
  EXPECT_EQ(ReasonForCeres(options), "");
  options.use_nonmonotonic_steps = true;
  EXPECT_EQ(ReasonForCeres(options), ChooseBackend(options, Prepare(options)).reason);
  EXPECT_NE(ReasonForCeres(options), "");
  options.backend = Backend::kFused;
  EXPECT_EQ(ReasonForCeres(options), "");
  options = SolveOptions();
  options.backend = Backend::kCeres;
  EXPECT_NE(ReasonForCeres(options), "");
}

/// Each kind of parameter beside the points is enough for the fused backend.
TEST(ReasonForCeres, AnythingBesidePoints) {
  SolveOptions points;
  points.refine_poses = points.refine_focal = points.refine_extra = false;
  EXPECT_NE(ReasonForCeres(points), "");
  for (bool SolveOptions::* kind :
       {&SolveOptions::refine_poses, &SolveOptions::refine_focal,
        &SolveOptions::refine_principal_point, &SolveOptions::refine_extra,
        &SolveOptions::refine_sensor_from_rig}) {
    SolveOptions options = points;
    options.*kind = true;
    EXPECT_EQ(ReasonForCeres(options), "");
  }
}

}  // namespace
}  // namespace bundle
