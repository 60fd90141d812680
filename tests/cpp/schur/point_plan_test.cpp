/// With so many points that the threads share them.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <vector>

#include "core/parallel/thread_pool.h"
#include "core/prepare/prepare.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/image_parts.h"
#include "core/sums/point_sections.h"
#include "support/scene.h"

namespace bundle {
namespace {

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
  mutable ThreadPool pool_{4};
};

/// Block and entries of each pair of a chunk, with the end of its tile.
std::vector<std::array<int, 4>> Listed(const Chunk& chunk) {
  std::vector<std::array<int, 4>> listed;
  size_t pair = 0;
  int block = 0;
  for (const Tile& tile : chunk.tiles) {
    for (; block < tile.last_block; ++block) {
      for (int k = 0; k < chunk.tile_blocks[block].num_pairs; ++k, ++pair) {
        const EntryPair& of = chunk.entry_pairs[pair];
        listed.push_back({tile.last_point, chunk.tile_blocks[block].block, of.first, of.second});
      }
    }
  }
  EXPECT_EQ(pair, chunk.entry_pairs.size());
  return listed;
}

void ExpectSame(const Chunk& a, const Chunk& b) {
  EXPECT_EQ(a.first_point, b.first_point);
  EXPECT_EQ(a.last_point, b.last_point);
  EXPECT_EQ(a.parts, b.parts);
  EXPECT_EQ(a.previous_chunk, b.previous_chunk);
  EXPECT_EQ(Listed(a), Listed(b));
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
      PlanPoints(problem_, *layout_, ImageParts(problem_, *layout_), nullptr,
                 /*keep_order=*/false, in_sections);
  const EliminationPlan four =
      PlanPoints(problem_, *layout_, ImageParts(problem_, *layout_), &pool_,
                 /*keep_order=*/false, in_sections);
  EXPECT_EQ(one.point, four.point);
  EXPECT_EQ(one.num_free_points, four.num_free_points);
  EXPECT_EQ(one.first, four.first);
  EXPECT_EQ(one.image, four.image);
  EXPECT_EQ(one.xy, four.xy);
  EXPECT_EQ(one.image_in_chunk, four.image_in_chunk);
  EXPECT_EQ(one.entry, four.entry);
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
  const EliminationPlan plan =
      PlanPoints(problem_, *layout_, ImageParts(problem_, *layout_), &pool_);
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
      PlanPoints(problem_, *layout_, ImageParts(problem_, *layout_), &pool_,
                 /*keep_order=*/false, in_sections);
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

/// A pair of parts of one point.
using PartPair = std::array<int, 3>;

/// The pairs of parts that each point of a plan must contribute: all pairs of its parts, and the
/// squares of those that several of its observations share or that are not own parts.
std::vector<PartPair> ExpectedPairs(const EliminationPlan& plan, const ImageParts& parts) {
  std::vector<PartPair> expected;
  for (int p = 0; p < plan.num_free_points; ++p) {
    std::map<int, int> count;
    for (int64_t i = plan.first[p]; i < plan.first[p + 1]; ++i) {
      for (int kind = 0; kind < kMaxParts; ++kind) {
        const int part = parts.part_of(plan.image[i], kind);
        if (part >= 0) ++count[part];
      }
    }
    for (auto a = count.begin(); a != count.end(); ++a) {
      if (a->second > 1 || a->first >= parts.num_own_parts()) {
        expected.push_back({p, a->first, a->first});
      }
      for (auto b = std::next(a); b != count.end(); ++b) {
        expected.push_back({p, a->first, b->first});
      }
    }
  }
  return expected;
}

/// The pairs of parts in the lists of a plan's tiles. The parts of an entry follow from the block
/// of the pair, and its point from the observations that name the entry.
std::vector<PartPair> ListedPairs(const EliminationPlan& plan, const ImageParts& parts) {
  std::vector<PartPair> found;
  for (const Chunk& chunk : plan.chunks) {
    int first_point = chunk.first_point, block = 0;
    size_t pair = 0;
    for (const Tile& tile : chunk.tiles) {
      std::map<int, std::pair<int, int>> entry;  // point and part
      for (int p = first_point; p < std::min(tile.last_point, plan.num_free_points); ++p) {
        for (int64_t i = plan.first[p]; i < plan.first[p + 1]; ++i) {
          for (int kind = 0; kind < plan.num_kinds; ++kind) {
            const int part = parts.part_of(plan.image[i], kind);
            if (part < 0) continue;
            const uint16_t of = plan.entry[i * plan.num_kinds + kind];
            const bool is_first = (of & EliminationPlan::kFirstOfEntry) != 0;
            const int number = of & (EliminationPlan::kFirstOfEntry - 1);
            EXPECT_LT(number, plan.largest_tile_entries);
            EXPECT_EQ(entry.try_emplace(number, p, part).second, is_first);
            EXPECT_EQ(entry[number], std::pair(p, part));
          }
        }
      }
      for (; block < tile.last_block; ++block) {
        const Tile::Block& of = chunk.tile_blocks[block];
        const auto num_parts = static_cast<int>(chunk.parts.size());
        const Chunk::Pair slots = of.block < num_parts ? Chunk::Pair{of.block, of.block}
                                                       : chunk.pairs[of.block - num_parts];
        for (int k = 0; k < of.num_pairs; ++k, ++pair) {
          const auto a = entry.at(chunk.entry_pairs[pair].first);
          const auto b = entry.at(chunk.entry_pairs[pair].second);
          EXPECT_EQ(a.first, b.first);
          EXPECT_EQ(a.second, chunk.parts[slots.first]);
          EXPECT_EQ(b.second, chunk.parts[slots.second]);
          found.push_back({a.first, a.second, b.second});
        }
      }
      EXPECT_LE(tile.last_point - first_point, plan.largest_tile_points);
      first_point = tile.last_point;
    }
    EXPECT_EQ(first_point, chunk.last_point);
  }
  return found;
}

/// Every pair of parts of a free point is in one chunk, with the block of its parts.
void ExpectNumbered(const EliminationPlan& plan, const ImageParts& parts) {
  int next_point = 0;
  for (size_t c = 0; c < plan.chunks.size(); ++c) {
    const Chunk& chunk = plan.chunks[c];
    ASSERT_EQ(chunk.first_point, next_point);
    const bool is_spread = chunk.last_row > 0;
    if (is_spread) {
      ASSERT_EQ(chunk.last_point, chunk.first_point + 1);
    } else {
      size_t num_refined = 0;
      for (int64_t i = plan.first[chunk.first_point]; i < plan.first[chunk.last_point]; ++i) {
        num_refined += parts.image_refined()[plan.image[i]];
      }
      EXPECT_EQ(chunk.tile_observations.size(), num_refined);
    }
    ASSERT_EQ(chunk.first_row, c > 0 && plan.chunks[c - 1].last_point != next_point
                                   ? plan.chunks[c - 1].last_row
                                   : 0);
    const bool goes_on =
        is_spread && c + 1 < plan.chunks.size() && plan.chunks[c + 1].first_row == chunk.last_row;
    next_point = goes_on ? chunk.first_point : chunk.last_point;
  }
  EXPECT_EQ(next_point, plan.num_points());
  std::vector<PartPair> expected = ExpectedPairs(plan, parts), found = ListedPairs(plan, parts);
  std::sort(expected.begin(), expected.end());
  std::sort(found.begin(), found.end());
  EXPECT_EQ(expected, found);
}

TEST_F(PointPlanTest, NumbersTheBlocksOfItsChunks) {
  const ImageParts parts(problem_, *layout_);
  ExpectNumbered(PlanPoints(problem_, *layout_, parts, &pool_), parts);
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
  bool poses_only;
  int length, repeat;
};

/// About the lengths at which as many rows as fit the buffer have more blocks than 16 bits number.
class LongTrackTest : public ::testing::TestWithParam<LongTrack> {};

TEST_P(LongTrackTest, HasNumbersForAllBlocksOfEachChunk) {
  const testing::Scene scene = LongTracks(GetParam().length, GetParam().repeat);
  const AdjustmentProblem problem = scene.View();
  SolveOptions options;
  options.refine_focal = options.refine_extra = !GetParam().poses_only;
  const ParameterLayout layout = PrepareSolve(problem, options).layout;
  const ImageParts parts(problem, layout);
  ThreadPool pool(2);
  const EliminationPlan plan = PlanPoints(problem, layout, parts, &pool);
  for (const Chunk& chunk : plan.chunks) EXPECT_LT(chunk.num_blocks(), 1 << 16);
  ExpectNumbered(plan, parts);
}

INSTANTIATE_TEST_SUITE_P(Lengths, LongTrackTest,
                         ::testing::Values(LongTrack{true, 255, 0}, LongTrack{true, 256, 0},
                                           LongTrack{true, 361, 0}, LongTrack{true, 362, 0},
                                           LongTrack{true, 415, 0}, LongTrack{true, 416, 0},
                                           LongTrack{true, 416, 3}, LongTrack{false, 373, 0},
                                           LongTrack{false, 537, 0}, LongTrack{false, 538, 7},
                                           LongTrack{false, 1335, 0}, LongTrack{false, 1336, 0}));

}  // namespace
}  // namespace bundle
