#include "core/scratch/page_arena.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <random>
#include <thread>
#include <utility>
#include <vector>

namespace bundle {
namespace {

constexpr size_t kPage = size_t{1} << 21;
constexpr size_t kQuarter = kPage / 4;
constexpr int kFull = 4 * 4;  ///< quarters of all large pages

class PageArena : public ::testing::Test {
 protected:
  void SetUp() override {
    void* const memory = AllocateInArena(kQuarter);
    if (memory == nullptr) GTEST_SKIP() << "no arena in this build";
    FreeInArena(memory, kQuarter);
  }
};

TEST_F(PageArena, TakesArraysOfSomePagesUpToHalfALargeOne) {
  const size_t least = size_t{1} << 14, most = kPage / 2;
  EXPECT_EQ(AllocateInArena(0), nullptr);
  EXPECT_EQ(AllocateInArena(least - 1), nullptr);
  EXPECT_EQ(AllocateInArena(most + 1), nullptr);
  EXPECT_EQ(AllocateInArena(SIZE_MAX), nullptr);
  for (const size_t size : {least, least + 1, most}) {
    void* const memory = AllocateInArena(size);
    ASSERT_NE(memory, nullptr);
    EXPECT_EQ(reinterpret_cast<uintptr_t>(memory) % 64, 0u);
    EXPECT_TRUE(IsInArena(memory));
    EXPECT_TRUE(FreeInArena(memory, size));
  }
}

TEST_F(PageArena, LeavesMemoryFromElsewhereAlone) {
  std::vector<char> heap(kQuarter);
  EXPECT_FALSE(IsInArena(heap.data()));
  EXPECT_FALSE(FreeInArena(heap.data(), heap.size()));
  EXPECT_FALSE(IsInArena(nullptr));
}

TEST_F(PageArena, ReusesTheMemoryOfTheLastArray) {
  void* const first = AllocateInArena(kQuarter);
  void* const second = AllocateInArena(kQuarter);
  EXPECT_EQ(static_cast<char*>(second) - static_cast<char*>(first), int64_t{kQuarter});
  FreeInArena(second, kQuarter);
  EXPECT_EQ(AllocateInArena(kQuarter), second);
  FreeInArena(first, kQuarter);  // not the last one: its memory is free when the page is empty
  void* const third = AllocateInArena(kQuarter);
  EXPECT_EQ(static_cast<char*>(third) - static_cast<char*>(second), int64_t{kQuarter});
  FreeInArena(second, kQuarter);
  FreeInArena(third, kQuarter);
  EXPECT_EQ(AllocateInArena(kQuarter), first);
  FreeInArena(first, kQuarter);
}

TEST_F(PageArena, ArraysBeginAtCacheLinesOnEachPage) {
  const size_t odd = kQuarter + 1;
  std::vector<void*> arrays;
  for (void* a = AllocateInArena(odd); a != nullptr; a = AllocateInArena(odd)) {
    EXPECT_EQ(reinterpret_cast<uintptr_t>(a) % 64, 0u);
    FreeInArena(a, odd);
    ASSERT_EQ(AllocateInArena(odd), a);  // the last array of its page
    arrays.push_back(a);
  }
  EXPECT_EQ(arrays.size(), 4u * 3);
  for (void* const array : arrays) FreeInArena(array, odd);
}

TEST_F(PageArena, IsFullAndEmptyAgain) {
  for (int round = 0; round < 3; ++round) {
    std::vector<void*> arrays;
    for (int k = 0; k < kFull; ++k) {
      arrays.push_back(AllocateInArena(kQuarter));
      ASSERT_NE(arrays.back(), nullptr);
      std::memset(arrays.back(), k, kQuarter);
    }
    EXPECT_EQ(AllocateInArena(kQuarter), nullptr);
    std::shuffle(arrays.begin(), arrays.end(), std::mt19937(round));
    for (void* const array : arrays) EXPECT_TRUE(FreeInArena(array, kQuarter));
  }
}

TEST_F(PageArena, AnArrayThatStaysKeepsOneLargePage) {
  void* const kept = AllocateInArena(kQuarter);
  for (int round = 0; round < 3; ++round) {
    std::vector<void*> arrays;
    for (void* a = AllocateInArena(kQuarter); a != nullptr; a = AllocateInArena(kQuarter)) {
      arrays.push_back(a);
    }
    EXPECT_GE(arrays.size(), size_t{kFull} - 4);
    for (void* const array : arrays) FreeInArena(array, kQuarter);
  }
  FreeInArena(kept, kQuarter);
}

TEST_F(PageArena, GivesThreadsDisjointMemory) {
  const auto work = [](uint32_t seed) {
    std::mt19937 random(seed);
    std::vector<ArenaVector<uint32_t>> arrays;
    for (int k = 0; k < 2000; ++k) {
      if (arrays.size() > 6) {
        std::swap(arrays[random() % arrays.size()], arrays.back());
        for (const uint32_t value : arrays.back()) ASSERT_EQ(value, seed);
        arrays.pop_back();
      }
      arrays.emplace_back(4096 + random() % 60000, seed);
    }
  };
  std::vector<std::thread> threads;
  for (uint32_t seed = 1; seed <= 4; ++seed) threads.emplace_back(work, seed);
  for (std::thread& thread : threads) thread.join();
  void* const whole = AllocateInArena(kPage / 2);
  EXPECT_NE(whole, nullptr);
  FreeInArena(whole, kPage / 2);
}

TEST_F(PageArena, VectorsOfAnySizeHaveTheirValues) {
  for (const size_t size : {size_t{0}, size_t{1}, size_t{3000}, size_t{100000}, size_t{3000000}}) {
    ArenaVector<double> vector(size, 2.5);
    vector.resize(size + 7);
    for (size_t k = 0; k < vector.size(); ++k) ASSERT_EQ(vector[k], k < size ? 2.5 : 0.0);
  }
}

}  // namespace
}  // namespace bundle
