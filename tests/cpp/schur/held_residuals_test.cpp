#include "core/schur/held_residuals.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <vector>

namespace bundle {
namespace {

/// A pass over a chunk that finds these observations; each holds (n, -n / 2).
void Pass(size_t chunk, const std::vector<int64_t>& found, HeldResiduals* held) {
  const HeldSink sink = held->Collect(chunk);
  for (const int64_t n : found) {
    sink.add(sink.list, {n, {static_cast<double>(n), -0.5 * static_cast<double>(n)}});
  }
}

HeldResiduals Merged(const std::vector<std::vector<int64_t>>& of_chunks) {
  HeldResiduals held(of_chunks.size());
  for (size_t c = 0; c < of_chunks.size(); ++c) Pass(c, of_chunks[c], &held);
  held.Merge();
  return held;
}

std::vector<int64_t> Observations(const HeldResiduals& held) {
  std::vector<int64_t> observations;
  for (const HeldResidual& one : held.all()) observations.push_back(one.observation);
  return observations;
}

TEST(HeldResiduals, NoneHoldsOneBeforeAPass) {
  EXPECT_TRUE(HeldResiduals(3).all().empty());
  EXPECT_TRUE(Merged({}).all().empty());
  EXPECT_TRUE(Merged({{}, {}, {}}).all().empty());
}

TEST(HeldResiduals, KeepTheResidualThatWasAdded) {
  HeldResiduals held(1);
  const HeldSink sink = held.Collect(0);
  ASSERT_NE(sink.add, nullptr);
  sink.add(sink.list, {7, {1.5, -2.5}});
  held.Merge();
  ASSERT_EQ(held.all().size(), 1u);
  EXPECT_EQ(held.all()[0].observation, 7);
  EXPECT_EQ(held.all()[0].residual[0], 1.5);
  EXPECT_EQ(held.all()[0].residual[1], -2.5);
}

TEST(HeldResiduals, TheirCostIsUnderTheLoss) {
  HeldResiduals held(2);
  const HeldSink first = held.Collect(0), second = held.Collect(1);
  first.add(first.list, {7, {3, -4}});
  second.add(second.list, {8, {0, 0.5}});
  EXPECT_EQ(held.Cost(LossType::kTrivial, 1).sum, 0) << "nothing is merged";
  held.Merge();
  EXPECT_EQ(held.Cost(LossType::kTrivial, 1).sum, 0.5 * (25 + 0.25));
  EXPECT_EQ(held.Cost(LossType::kHuber, 2).sum, 0.5 * (2 * 2 * 5 - 4 + 0.25));
}

TEST(HeldResiduals, WhatIsReleasedIsHeldNoMore) {
  HeldResiduals held = Merged({{40, 3, 17}, {}, {5, 1}});
  const auto is_odd = [](const HeldResidual& one) { return one.observation % 2 == 1; };
  EXPECT_EQ(held.Release(is_odd), 4);
  EXPECT_EQ(Observations(held), std::vector<int64_t>{40});
  EXPECT_EQ(held.Release(is_odd), 0);
}

/// Whatever the order of the chunks and of the passes over them: several camera models in a chunk
/// are gone through one after the other. Residuals move with their observations.
TEST(HeldResiduals, AreMergedInAscendingOrder) {
  const HeldResiduals held = Merged({{40, 3, 17}, {}, {5, 1}, {int64_t{1} << 40}});
  EXPECT_EQ(Observations(held), (std::vector<int64_t>{1, 3, 5, 17, 40, int64_t{1} << 40}));
  for (const HeldResidual& one : held.all()) {
    EXPECT_EQ(one.residual[0], static_cast<double>(one.observation));
    EXPECT_EQ(one.residual[1], -0.5 * static_cast<double>(one.observation));
  }
}

/// Reading returns the state of the last merge: a pass under way changes nothing.
TEST(HeldResiduals, AreThoseOfTheLastMerge) {
  HeldResiduals held = Merged({{1, 2}, {8}});
  Pass(0, {4}, &held);
  EXPECT_EQ(Observations(held), (std::vector<int64_t>{1, 2, 8}));
  held.Merge();
  EXPECT_EQ(Observations(held), (std::vector<int64_t>{4, 8}));
}

/// A pass over one chunk forgets what that chunk held, and nothing of the others.
TEST(HeldResiduals, AreForgottenChunkByChunk) {
  HeldResiduals held = Merged({{1, 2}, {8, 9}, {12}});
  Pass(1, {}, &held);
  held.Merge();
  EXPECT_EQ(Observations(held), (std::vector<int64_t>{1, 2, 12}));
  Pass(2, {12, 13}, &held);
  held.Merge();
  EXPECT_EQ(Observations(held), (std::vector<int64_t>{1, 2, 12, 13}));
}

/// Chunks are passed over by several threads: one chunk's list stays where it is while another
/// grows.
TEST(HeldResiduals, TakeFromChunksByTurns) {
  HeldResiduals held(2);
  const HeldSink first = held.Collect(0), second = held.Collect(1);
  std::vector<int64_t> expected;
  for (int64_t n = 0; n < 1000; ++n) {
    const HeldSink& sink = n % 2 == 0 ? first : second;
    sink.add(sink.list, {n, {0, 0}});
    expected.push_back(n);
  }
  held.Merge();
  EXPECT_EQ(Observations(held), expected);
}

/// Merging twice counts nothing twice.
TEST(HeldResiduals, AreMergedAfresh) {
  HeldResiduals held = Merged({{3}, {5, 4}});
  held.Merge();
  EXPECT_EQ(Observations(held), (std::vector<int64_t>{3, 4, 5}));
}

TEST(HeldResiduals, AreComparedByObservations) {
  const auto same = [](const HeldResiduals& a, const HeldResiduals& b) {
    EXPECT_EQ(a.HasSameObservations(b), b.HasSameObservations(a));
    return a.HasSameObservations(b);
  };
  EXPECT_TRUE(same(Merged({}), Merged({{}, {}})));
  EXPECT_TRUE(same(Merged({{1, 5}, {3}}), Merged({{5}, {}, {3, 1}})));
  EXPECT_FALSE(same(Merged({{1, 3}}), Merged({{1, 3, 5}})));  // a beginning of it
  EXPECT_FALSE(same(Merged({{1, 3}}), Merged({{1, 4}})));
  EXPECT_FALSE(same(Merged({{1}}), Merged({{}})));
}

/// The residual may differ: no observation begins or ceases to count by that.
TEST(HeldResiduals, AreTheSameWithOtherResiduals) {
  HeldResiduals other(1);
  const HeldSink sink = other.Collect(0);
  sink.add(sink.list, {2, {100, 200}});
  other.Merge();
  EXPECT_TRUE(Merged({{2}}).HasSameObservations(other));
}

/// An image that sees a point twice makes two observations, which hold their own residuals.
TEST(HeldResiduals, KeepRepeatedObservationsApart) {
  HeldResiduals held(2);
  const HeldSink sink = held.Collect(1);
  sink.add(sink.list, {11, {3, 4}});
  sink.add(sink.list, {10, {1, 2}});
  held.Merge();
  ASSERT_EQ(Observations(held), (std::vector<int64_t>{10, 11}));
  EXPECT_EQ(held.all()[0].residual[1], 2);
  EXPECT_EQ(held.all()[1].residual[1], 4);
  EXPECT_FALSE(held.HasSameObservations(Merged({{10}})));
}

}  // namespace
}  // namespace bundle
