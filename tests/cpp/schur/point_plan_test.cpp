/// With so many points that the threads share them.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <vector>

#include "core/prepare/prepare.h"
#include "core/schur/elimination_plan.h"
#include "core/sums/point_sections.h"
#include "support/scene.h"

namespace bundle {
namespace {

constexpr int kBlockBytes = 512;

/// Observations in no order, some of them twice, and every fifth point fixed.
class PointPlanTest : public ::testing::Test {
 protected:
  PointPlanTest() {
    testing::SceneOptions options;
    options.num_images = 40;
    options.num_points = 45000;
    options.track_length = 6;
    scene_ = testing::MakeScene(options);
    testing::RepeatObservations(97, &scene_);
    testing::ShuffleObservations(2, &scene_);
    problem_ = scene_.View();
    SolveOptions solve_options;
    for (size_t p = 0; p < scene_.point_ids.size(); p += 5) {
      solve_options.fixed_point_ids.push_back(scene_.point_ids[p]);
    }
    solve_options.fixed_image_ids = {scene_.image_ids[3]};
    solve_options.fixed_camera_ids = {scene_.camera_ids[3]};
    layout_ = std::make_unique<ParameterLayout>(PrepareSolve(problem_, solve_options).layout);
  }

  void ExpectSamePlans(bool in_sections) const;
  void ExpectSorted(bool in_sections) const;

  testing::Scene scene_;
  AdjustmentProblem problem_;
  std::unique_ptr<ParameterLayout> layout_;
};

void ExpectSame(const Chunk& a, const Chunk& b) {
  EXPECT_EQ(a.first_point, b.first_point);
  EXPECT_EQ(a.last_point, b.last_point);
  EXPECT_EQ(a.first_pair, b.first_pair);
  EXPECT_EQ(a.images, b.images);
  EXPECT_EQ(a.previous_chunk, b.previous_chunk);
  ASSERT_EQ(a.pairs.size(), b.pairs.size());
  for (size_t k = 0; k < a.pairs.size(); ++k) {
    EXPECT_EQ(a.pairs[k].first, b.pairs[k].first);
    EXPECT_EQ(a.pairs[k].second, b.pairs[k].second);
  }
}

TEST_F(PointPlanTest, IsTheSameForAnyNumberOfThreads) {
  for (const bool in_sections : {false, true}) ExpectSamePlans(in_sections);
}

void PointPlanTest::ExpectSamePlans(bool in_sections) const {
  const EliminationPlan one =
      PlanPoints(problem_, *layout_, kBlockBytes, 1, /*keep_order=*/false, in_sections);
  const EliminationPlan four =
      PlanPoints(problem_, *layout_, kBlockBytes, 4, /*keep_order=*/false, in_sections);
  EXPECT_EQ(one.point, four.point);
  EXPECT_EQ(one.num_free_points, four.num_free_points);
  EXPECT_EQ(one.first, four.first);
  EXPECT_EQ(one.image, four.image);
  EXPECT_EQ(one.xy, four.xy);
  EXPECT_EQ(one.image_in_chunk, four.image_in_chunk);
  EXPECT_EQ(one.pair_block, four.pair_block);
  ASSERT_EQ(one.chunks.size(), four.chunks.size());
  ASSERT_GT(one.chunks.size(), 32u);
  for (size_t c = 0; c < one.chunks.size(); ++c) ExpectSame(one.chunks[c], four.chunks[c]);
}

TEST_F(PointPlanTest, HasEveryObservationThatSomethingRefines) {
  using Observation = std::array<double, 3>;
  std::map<int, std::vector<Observation>> expected;
  for (int64_t i = 0; i < problem_.num_observations; ++i) {
    const int image = problem_.observation_image[i], point = problem_.observation_point[i];
    if (layout_->point_is_free(point) || layout_->image_block(image) >= 0) {
      const double* xy = problem_.observation_xy + 2 * i;
      expected[point].push_back({static_cast<double>(image), xy[0], xy[1]});
    }
  }
  const EliminationPlan plan = PlanPoints(problem_, *layout_, kBlockBytes, 4);
  ASSERT_EQ(plan.point.size(), expected.size());
  for (int p = 0; p < plan.num_points(); ++p) {
    EXPECT_EQ(layout_->point_is_free(plan.point[p]), p < plan.num_free_points);
    std::vector<Observation> found;
    for (int64_t k = plan.first[p]; k < plan.first[p + 1]; ++k) {
      found.push_back({static_cast<double>(plan.image[k]), plan.xy[2 * k], plan.xy[2 * k + 1]});
    }
    std::vector<Observation>& of_point = expected[plan.point[p]];
    std::sort(found.begin(), found.end());
    std::sort(of_point.begin(), of_point.end());
    EXPECT_EQ(found, of_point);
  }
}

TEST_F(PointPlanTest, IsSortedByTheImagesOfEachPoint) {
  for (const bool in_sections : {false, true}) ExpectSorted(in_sections);
}

void PointPlanTest::ExpectSorted(bool in_sections) const {
  const std::vector<uint16_t> section = testing::SectionsOf(problem_, 2);
  const auto section_of = [&](const EliminationPlan& plan, int p) {
    return in_sections ? int{section[plan.point[p]]} : 0;
  };
  const auto rank = [&](int image) {
    const int block = layout_->image_block(image);
    return block >= 0 ? block : problem_.num_images;
  };
  const EliminationPlan plan =
      PlanPoints(problem_, *layout_, kBlockBytes, 4, /*keep_order=*/false, in_sections);
  for (const Chunk& chunk : plan.chunks) {
    EXPECT_EQ(section_of(plan, chunk.first_point), section_of(plan, chunk.last_point - 1));
  }
  std::vector<int> before;
  for (int p = 0; p < plan.num_points(); ++p) {
    std::vector<int> ranks;
    for (int64_t k = plan.first[p]; k < plan.first[p + 1]; ++k)
      ranks.push_back(rank(plan.image[k]));
    EXPECT_TRUE(std::is_sorted(ranks.begin(), ranks.end()));
    const bool is_first_of_section = p != 0 && section_of(plan, p) != section_of(plan, p - 1);
    if (is_first_of_section && p != plan.num_free_points) {
      EXPECT_LT(section_of(plan, p - 1), section_of(plan, p));
    }
    if (p != 0 && p != plan.num_free_points && !is_first_of_section) {
      EXPECT_LE(before, ranks);
      if (before == ranks) {
        EXPECT_LT(plan.point[p - 1], plan.point[p]);
      }
    }
    before = ranks;
  }
}

/// The blocks of pairs of observations [first_row, last_row) of a point that are not those of their
/// images.
int64_t CountWrongPairs(const EliminationPlan& plan, const Chunk& chunk, int point, int first_row,
                        int last_row, int refined, int64_t next_pair) {
  int64_t wrong = 0;
  const int64_t first = plan.first[point];
  const auto num_images = static_cast<int>(chunk.images.size());
  for (int i = first_row; i < last_row; ++i) {
    for (int j = i + 1; j < refined; ++j) {
      const int block = plan.pair_block[next_pair++];
      const int a = plan.image_in_chunk[first + i], b = plan.image_in_chunk[first + j];
      if (a == b) {
        wrong += block != a;
      } else {
        wrong += block < num_images || block >= chunk.num_blocks() ||
                 chunk.pairs[block - num_images].first != a ||
                 chunk.pairs[block - num_images].second != b;
      }
    }
  }
  return wrong;
}

/// Every pair of observations of a free point is in one chunk, with the block of its images.
void ExpectNumbered(const EliminationPlan& plan, const ParameterLayout& layout) {
  int next_point = 0, next_row = 0;
  int64_t next_pair = 0;
  for (const Chunk& chunk : plan.chunks) {
    ASSERT_EQ(chunk.first_point, next_point);
    ASSERT_EQ(chunk.first_row, next_row);
    ASSERT_EQ(chunk.first_pair, next_pair);
    next_point = chunk.last_point;
    next_row = 0;
    for (int p = chunk.first_point; p < chunk.last_point; ++p) {
      int refined = 0;
      for (int64_t i = plan.first[p]; i < plan.first[p + 1]; ++i) {
        ASSERT_EQ(chunk.images[plan.image_in_chunk[i]], plan.image[i]);
        refined += p < plan.num_free_points && layout.image_block(plan.image[i]) >= 0;
      }
      const int last_row = chunk.last_row > 0 ? chunk.last_row : refined;
      ASSERT_LE(last_row, refined);
      EXPECT_EQ(CountWrongPairs(plan, chunk, p, chunk.first_row, last_row, refined, next_pair), 0);
      for (int i = chunk.first_row; i < last_row; ++i) next_pair += refined - 1 - i;
      if (last_row == refined) continue;
      next_point = p;
      next_row = last_row;
    }
  }
  EXPECT_EQ(next_point, plan.num_points());
  EXPECT_EQ(next_pair, static_cast<int64_t>(plan.pair_block.size()));
}

TEST_F(PointPlanTest, NumbersTheBlocksOfItsChunks) {
  ExpectNumbered(PlanPoints(problem_, *layout_, kBlockBytes, 4), *layout_);
}

/// `length` images that all see the first two points; three of them see another hundred. `repeat`:
/// every so manieth observation is made twice; 0: none.
testing::Scene LongTracks(int length, int repeat) {
  testing::SceneOptions options;
  options.num_images = length;
  options.num_points = 102;
  testing::Scene scene = testing::MakeScene(options);
  if (repeat > 0) testing::RepeatObservations(repeat, &scene);
  const testing::Scene all = scene;
  scene.observation_image.clear();
  scene.observation_point.clear();
  scene.observation_xy.clear();
  for (int64_t i = 0; i < all.num_observations(); ++i) {
    const int image = all.observation_image[i], point = all.observation_point[i];
    if (point >= 2 && (image + point) % (length / 3) != 0) continue;
    scene.observation_image.push_back(image);
    scene.observation_point.push_back(point);
    scene.observation_xy.insert(scene.observation_xy.end(), all.observation_xy.begin() + 2 * i,
                                all.observation_xy.begin() + 2 * i + 2);
  }
  return scene;
}

struct LongTrack {
  int unknowns, length, repeat;
};

/// About the lengths at which as many rows as fit the buffer have more blocks than 16 bits number.
class LongTrackTest : public ::testing::TestWithParam<LongTrack> {};

TEST_P(LongTrackTest, HasNumbersForAllBlocksOfEachChunk) {
  const testing::Scene scene = LongTracks(GetParam().length, GetParam().repeat);
  const AdjustmentProblem problem = scene.View();
  const ParameterLayout layout = PrepareSolve(problem, SolveOptions{}).layout;
  const int width = (GetParam().unknowns + 3) / 4 * 4;
  const int block_bytes = GetParam().unknowns * width * static_cast<int>(sizeof(double));
  const EliminationPlan plan = PlanPoints(problem, layout, block_bytes, 2);
  for (const Chunk& chunk : plan.chunks) EXPECT_LT(chunk.num_blocks(), 1 << 16);
  ExpectNumbered(plan, layout);
}

INSTANTIATE_TEST_SUITE_P(Lengths, LongTrackTest,
                         ::testing::Values(LongTrack{2, 255, 0}, LongTrack{2, 256, 0},
                                           LongTrack{2, 361, 0}, LongTrack{2, 362, 0},
                                           LongTrack{5, 373, 0}, LongTrack{6, 415, 0},
                                           LongTrack{6, 416, 0}, LongTrack{6, 416, 3},
                                           LongTrack{7, 537, 0}, LongTrack{7, 538, 0},
                                           LongTrack{7, 538, 7}, LongTrack{8, 1335, 0},
                                           LongTrack{8, 1336, 0}, LongTrack{24, 1400, 0}));

}  // namespace
}  // namespace bundle
