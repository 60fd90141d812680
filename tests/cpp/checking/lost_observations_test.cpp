#include "core/checking/lost_observations.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/model/free_parameters.h"
#include "core/model/parameter_layout.h"
#include "support/scene.h"

namespace bundle {
namespace {

using testing::MakeScene;
using testing::Scene;
using testing::SceneOptions;

constexpr WarningKind kBehind = WarningKind::kObservationsBehind;
constexpr WarningKind kUnusable = WarningKind::kTooManyBehind;
constexpr WarningKind kLeftOut = WarningKind::kObservationsLeftOut;

/// 200 points, each seen by one image: what is behind is counted point by point.
Scene SeenOnce(int num_images = 8, int images_per_camera = 1) {
  SceneOptions options;
  options.num_images = num_images;
  options.num_points = 200;
  options.track_length = 1;
  options.images_per_camera = images_per_camera;
  return MakeScene(options);
}

/// Puts `count` points from `first` on behind all cameras.
void PutBehind(int first, int count, std::vector<double>* points) {
  for (int p = first; p < first + count; ++p) {
    double* const point = &(*points)[3 * static_cast<size_t>(p)];
    point[0] = point[1] = 0, point[2] = -100;
  }
}

/// Warnings of a solve from `scene` that ends at `points` with `num_held` held residuals.
SolveSummary Judge(const Scene& scene, const std::vector<double>& points, int64_t num_held,
                   SolveOptions options = {}) {
  options.num_threads = 1;
  const AdjustmentProblem view = scene.View();
  const ParameterLayout layout(view, SelectFreeParameters(view, options));
  SolveOutput output;
  output.cam_from_world = scene.cam_from_world;
  output.camera_params = scene.camera_params;
  output.points.assign(points.begin(), points.end());
  output.summary.is_solution_usable = true;
  JudgeLostObservations(view, layout, options, num_held, &output);
  return output.summary;
}

std::vector<WarningKind> Kinds(const SolveSummary& summary) {
  std::vector<WarningKind> kinds;
  for (const Warning& warning : summary.warnings) kinds.push_back(warning.kind);
  return kinds;
}

using List = std::vector<WarningKind>;

TEST(LostObservations, UpToOneInAHundredMayBeLost) {
  const Scene scene = SeenOnce();
  std::vector<double> points = scene.points;
  EXPECT_EQ(Kinds(Judge(scene, points, 0)), List());
  PutBehind(0, 2, &points);
  const SolveSummary two = Judge(scene, points, 2);
  EXPECT_TRUE(two.is_solution_usable);
  ASSERT_EQ(Kinds(two), List({kBehind}));
  EXPECT_EQ(two.warnings[0].text.rfind("2 of 200 ", 0), 0u) << two.warnings[0].text;
  PutBehind(2, 1, &points);
  const SolveSummary three = Judge(scene, points, 3);
  EXPECT_FALSE(three.is_solution_usable);
  EXPECT_EQ(Kinds(three), List({kBehind, kUnusable}));
}

/// The share is of the observations that count at the start, not of all.
TEST(LostObservations, TheShareIsOfThoseInFrontAtTheStart) {
  Scene scene = SeenOnce();
  PutBehind(0, 100, &scene.points);
  std::vector<double> points = scene.points;
  PutBehind(100, 1, &points);
  EXPECT_TRUE(Judge(scene, points, 101).is_solution_usable);
  PutBehind(101, 1, &points);
  const SolveSummary summary = Judge(scene, points, 102);
  EXPECT_FALSE(summary.is_solution_usable);
  EXPECT_NE(summary.warnings.back().text.find("of the 100 observations"), std::string::npos);
}

TEST(LostObservations, AsManyBehindAsBeforeAreNotWorthAWord) {
  Scene scene = SeenOnce();
  PutBehind(0, 5, &scene.points);
  EXPECT_EQ(Kinds(Judge(scene, scene.points, 5)), List());
}

/// Lost ones are not made up for by others that came back.
TEST(LostObservations, ThoseThatCameBackDoNotHideTheLost) {
  Scene scene = SeenOnce();
  const std::vector<double> in_front = scene.points;
  PutBehind(0, 5, &scene.points);
  std::vector<double> points = in_front;
  PutBehind(10, 5, &points);
  const SolveSummary summary = Judge(scene, points, 5);
  EXPECT_FALSE(summary.is_solution_usable);
  EXPECT_EQ(Kinds(summary), List({kBehind, kUnusable}));
}

/// All ids up to six, else five and how many more; an image that sees nothing lacks nothing.
TEST(LostObservations, ImagesWithNoneInFrontAreNamed) {
  const auto named = [](int num_images) {
    Scene scene = SeenOnce(num_images + 1);
    testing::AddUnobserved(&scene);
    int64_t num_held = 0;
    for (int64_t i = 0; i < scene.num_observations(); ++i) {
      if (scene.observation_image[i] >= num_images) continue;
      PutBehind(scene.observation_point[i], 1, &scene.points);
      ++num_held;
    }
    const SolveSummary summary = Judge(scene, scene.points, num_held);
    return summary.warnings.empty() ? std::string() : summary.warnings[0].text;
  };
  EXPECT_EQ(named(0), "");
  EXPECT_NE(named(1).find("; image 1 has no observation in front"), std::string::npos) << named(1);
  EXPECT_NE(named(2).find("; images 1 and 3 have no observation"), std::string::npos) << named(2);
  EXPECT_NE(named(6).find("; images 1, 3, 5, 7, 9 and 11 have no observation"), std::string::npos);
  EXPECT_NE(named(7).find("; images 1, 3, 5, 7, 9 and 2 more have no observation"),
            std::string::npos);
}

TEST(LostObservations, ThoseInFrontAtTheEndThatWereHeldAreCounted) {
  Scene scene = SeenOnce();
  std::vector<double> points = scene.points;
  PutBehind(0, 5, &scene.points);
  PutBehind(0, 2, &points);
  const SolveSummary three = Judge(scene, points, 5);
  ASSERT_EQ(Kinds(three), List({kLeftOut}));
  EXPECT_EQ(three.warnings[0].text.rfind("3 observations ", 0), 0u);
  EXPECT_EQ(Judge(scene, points, 3).warnings[0].text.rfind("1 observation ", 0), 0u);
  EXPECT_EQ(Kinds(Judge(scene, points, 2)), List());
}

/// One that is behind at the end is held if anything of it is refined, be it only the pose or only
/// the intrinsics that images share; else it is not among those held.
TEST(LostObservations, HeldOnesHaveSomethingToRefine) {
  SolveOptions points_only, poses_only, intrinsics_only, nothing;
  points_only.refine_poses = points_only.refine_focal = points_only.refine_extra = false;
  poses_only.refine_points = poses_only.refine_focal = poses_only.refine_extra = false;
  intrinsics_only.refine_points = intrinsics_only.refine_poses = false;
  nothing = points_only;
  nothing.refine_points = false;
  Scene scene = SeenOnce(8, 4);
  PutBehind(0, 4, &scene.points);
  for (const SolveOptions& options : {points_only, poses_only, intrinsics_only}) {
    EXPECT_EQ(Kinds(Judge(scene, scene.points, 4, options)), List());
    EXPECT_EQ(Kinds(Judge(scene, scene.points, 5, options)), List({kLeftOut}));
  }
  EXPECT_EQ(Kinds(Judge(scene, scene.points, 1, nothing)), List({kLeftOut}));
}

/// Where observations behind count, only those without a projection do not.
TEST(LostObservations, AlgebraicOnesCountBehind) {
  SolveOptions options;
  options.cheirality = Cheirality::kAlgebraic;
  const Scene scene = SeenOnce();
  std::vector<double> points = scene.points;
  PutBehind(0, 20, &points);
  const SolveSummary summary = Judge(scene, points, 0, options);
  EXPECT_TRUE(summary.is_solution_usable);
  EXPECT_EQ(Kinds(summary), List());
}

}  // namespace
}  // namespace bundle
