#include "core/covariance/leverages.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <limits>

#include "support/scene.h"

namespace bundle {
namespace {

using Rows = Eigen::Map<const Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>>;

/// Leaves NaN on the stack below the caller.
[[gnu::noinline]] void SpoilStack() {
  volatile double below[1 << 15];
  for (volatile double& value : below) value = std::numeric_limits<double>::quiet_NaN();
}

/// A pose has more unknowns than a camera here: a product of the two blocks must not read what
/// follows the rows of the smaller one.
TEST(Leverages, OfConstantPointsReadDefinedNumbersOnly) {
  testing::SceneOptions scene_options;
  scene_options.model = "SIMPLE_PINHOLE";
  scene_options.images_per_camera = 5;  // a block of its own
  const testing::Scene scene = testing::MakeScene(scene_options);
  const AdjustmentProblem problem = scene.View();
  SolveOptions options;
  options.num_threads = 1;
  options.refine_points = false;
  const ReducedSystem system(problem, options);
  const LongMatrix identity = LongMatrix::Identity(system.num_unknowns(), system.num_unknowns());
  int64_t num_visited = 0;
  SpoilStack();
  ForLeverages(system, identity, [&](const Leverage& of) {
    const ObservationRows& rows = *of.rows;
    EXPECT_EQ(rows.num_blocks, 2);
    ++num_visited;
    Eigen::Matrix2d expected = Eigen::Matrix2d::Zero();
    for (int k = 0; k < rows.num_blocks; ++k) {
      const Rows a(rows.jacobian[k], 2, rows.size[k]);
      expected += a * a.transpose();
    }
    EXPECT_LE((of.h - expected).norm(), 1e-14 * expected.norm());
  });
  EXPECT_EQ(num_visited, problem.num_observations);
}

}  // namespace
}  // namespace bundle
