#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "core/parallel/thread_pool.h"
#include "core/prepare/prepare.h"
#include "core/schur/assembly/ordered_sums.h"
#include "core/schur/schur_setup.h"
#include "core/schur/state_records.h"
#include "schur/schur_comparison.h"
#include "support/scene.h"

namespace bundle {
namespace {

/// The sums of a chunk at a state.
struct Eliminated {
  std::vector<double> blocks, vectors, squared_scale;
  double cost;

  Eliminated(const SchurSetup& setup, const StateRecords& x, const Chunk& chunk)
      : squared_scale(3 * setup.plan.point.size()) {
    std::vector<int64_t> block_begin;
    blocks.resize(PlaceBlocks(setup.input, chunk, &block_begin));
    vectors.resize(chunk.parts.size() * ChunkSum::kVectors * setup.input.part_columns);
    std::vector<double> memory(setup.kernels.memory_doubles(setup.input) + 8);
    ChunkSum sum;
    sum.blocks = blocks.data();
    sum.block_begin = block_begin.data();
    sum.vectors = vectors.data();
    setup.kernels.eliminate(setup.input, x, chunk, 1e-4, true, squared_scale.data(), memory.data(),
                            &sum);
    cost = sum.cost;
  }
};

/// A candidate stores where the iterations of its rows end. From there, and from the measured rows,
/// a pass finds the same numbers.
void ExpectSameBits(const std::string& model, double rate, double noise) {
  testing::SceneOptions options;
  options.model = model;
  options.num_points = 70;
  options.track_length = 4;
  options.noise = noise;
  const testing::Scene scene = testing::MakeScene(options);
  AdjustmentProblem problem = scene.View();
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  std::vector<double> twists(6 * scene.num_images());
  for (size_t i = 0; i < twists.size(); ++i)
    twists[i] = rate * (i % 6 < 3 ? 1 : 4) * normal(random);
  const std::vector<double> readouts(scene.num_cameras(), std::numeric_limits<double>::quiet_NaN());
  for (int c = 0; c < scene.num_cameras(); ++c) {
    problem.row_scale.push_back(c % 2 == 0 ? 0 : 1.0 / 800);
    problem.row_scale.push_back(c % 2 == 0 ? 1.0 / 600 : 0);
  }
  problem.twists = twists.data();
  problem.readouts = readouts.data();
  const SolveOptions solve;
  const PreparedSolve prepared = PrepareSolve(problem, solve);
  ThreadPool pool(1);
  const SchurSetup setup(problem, prepared.layout, solve,
                         Structure(problem, prepared.layout, /*dense=*/true), false, false, &pool);
  const State cold(problem, prepared.layout, setup.plan);
  State warm(problem, prepared.layout, setup.plan);
  const StateRecords before = cold.records();
  for (size_t c = 0; c < setup.plan.chunks.size(); ++c) {
    const StateRecords candidate = warm.CandidateRecords(before, static_cast<int>(c));
    setup.kernels.cost(setup.input, candidate, setup.plan.chunks[c]);
  }
  int known = 0;
  const double* const row_times = warm.records().row_times;
  for (int64_t i = 0; i < setup.plan.num_observations(); ++i) {
    EXPECT_TRUE(std::isnan(before.row_times[i]));
    known += std::isnan(row_times[i]) ? 0 : 1;
  }
  EXPECT_GT(known, 0.9 * static_cast<double>(setup.plan.num_observations()));
  for (const Chunk& chunk : setup.plan.chunks) {
    const Eliminated one(setup, before, chunk), other(setup, warm.records(), chunk);
    EXPECT_GT(one.cost, 0);
    EXPECT_EQ(one.cost, other.cost);
    EXPECT_EQ(one.blocks, other.blocks);
    EXPECT_EQ(one.vectors, other.vectors);
    EXPECT_EQ(one.squared_scale, other.squared_scale);
  }
}

TEST(RowTimes, KnownOnesChangeNoBit) {
  ExpectSameBits("SIMPLE_RADIAL", 0.02, 0.5);
  ExpectSameBits("PINHOLE", 0.1, 20);
  ExpectSameBits("OPENCV_FISHEYE", 0.05, 3);
  ExpectSameBits("OPENCV", 0, 1);
}

}  // namespace
}  // namespace bundle
