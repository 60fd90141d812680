#include <gtest/gtest.h>

#include <atomic>
#include <cstdint>
#include <limits>
#include <mutex>
#include <new>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "core/parallel/thread_pool.h"
#include "support/no_threads.h"

namespace bundle {
namespace {

/// The slices that ParallelFor makes, ascending.
std::set<std::pair<int64_t, int64_t>> Slices(int64_t count, int num_threads, int64_t min_slice) {
  std::mutex mutex;
  std::set<std::pair<int64_t, int64_t>> slices;
  ParallelFor(
      count, num_threads,
      [&](int64_t begin, int64_t end) {
        const std::lock_guard<std::mutex> lock(mutex);
        slices.emplace(begin, end);
      },
      min_slice);
  return slices;
}

TEST(ParallelFor, CutsIntoConsecutiveSlices) {
  using Set = std::set<std::pair<int64_t, int64_t>>;
  EXPECT_EQ(Slices(10, 3, 1), (Set{{0, 3}, {3, 6}, {6, 10}}));
  EXPECT_EQ(Slices(10, 3, 6), (Set{{0, 10}}));
  EXPECT_EQ(Slices(0, 3, 1), (Set{{0, 0}}));
  constexpr int64_t kMost = std::numeric_limits<int64_t>::max();
  const auto slices = Slices(kMost, 7, 1);
  EXPECT_EQ(slices.size(), 7u);
  EXPECT_EQ(slices.begin()->first, 0);
  EXPECT_EQ(slices.rbegin()->second, kMost);
  int64_t last = 0;
  for (const auto& [begin, end] : slices) {
    EXPECT_EQ(begin, last);
    last = end;
  }
}

TEST(ParallelFor, ThrowsWhatASliceThrewWhenAllHaveEnded) {
  for (int64_t bad = 0; bad < 4; ++bad) {
    std::atomic<int> ended{0};
    const auto run = [&](int64_t slice) {
      if (slice == bad) throw std::runtime_error("slice " + std::to_string(slice));
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      ++ended;
    };
    try {
      RunOnThreads(4, run);
      FAIL() << "nothing was thrown";
    } catch (const std::runtime_error& error) {
      EXPECT_EQ(error.what(), "slice " + std::to_string(bad));
    }
    EXPECT_EQ(ended, 3);
  }
  EXPECT_THROW(RunOnThreads(8, [](int64_t) { throw std::bad_alloc(); }), std::bad_alloc);
}

TEST(ParallelFor, RunsHereWhatHasNoThread) {
  const testing::NoThreads none;
  std::vector<int64_t> ran;  // by this thread alone, so it needs no lock
  RunOnThreads(4, [&](int64_t slice) { ran.push_back(slice); });
  EXPECT_EQ(ran, (std::vector<int64_t>{0, 1, 2, 3}));
  EXPECT_EQ(CountStartableThreads(4), 1);
}

TEST(ParallelFor, CountsThreadsThatStart) {
  EXPECT_EQ(CountStartableThreads(3), 3);
  EXPECT_EQ(CountStartableThreads(1), 1);
}

}  // namespace
}  // namespace bundle
