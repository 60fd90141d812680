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

/// The ranges that ParallelFor makes, ascending.
std::set<std::pair<int64_t, int64_t>> Ranges(int64_t count, int num_threads, int64_t min_range) {
  std::mutex mutex;
  std::set<std::pair<int64_t, int64_t>> ranges;
  ParallelFor(
      count, num_threads,
      [&](int64_t begin, int64_t end) {
        const std::lock_guard<std::mutex> lock(mutex);
        ranges.emplace(begin, end);
      },
      min_range);
  return ranges;
}

TEST(ParallelFor, CutsIntoConsecutiveRanges) {
  using Set = std::set<std::pair<int64_t, int64_t>>;
  EXPECT_EQ(Ranges(10, 3, 1), (Set{{0, 3}, {3, 6}, {6, 10}}));
  EXPECT_EQ(Ranges(10, 3, 6), (Set{{0, 10}}));
  EXPECT_EQ(Ranges(0, 3, 1), (Set{{0, 0}}));
  constexpr int64_t kMost = std::numeric_limits<int64_t>::max();
  const auto ranges = Ranges(kMost, 7, 1);
  EXPECT_EQ(ranges.size(), 7u);
  EXPECT_EQ(ranges.begin()->first, 0);
  EXPECT_EQ(ranges.rbegin()->second, kMost);
  int64_t last = 0;
  for (const auto& [begin, end] : ranges) {
    EXPECT_EQ(begin, last);
    last = end;
  }
}

TEST(ParallelFor, ThrowsWhatARangeThrewWhenAllHaveEnded) {
  for (int64_t bad = 0; bad < 4; ++bad) {
    std::atomic<int> ended{0};
    const auto run = [&](int64_t range) {
      if (range == bad) throw std::runtime_error("range " + std::to_string(range));
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
      ++ended;
    };
    try {
      RunOnThreads(4, run);
      FAIL() << "nothing was thrown";
    } catch (const std::runtime_error& error) {
      EXPECT_EQ(error.what(), "range " + std::to_string(bad));
    }
    EXPECT_EQ(ended, 3);
  }
  EXPECT_THROW(RunOnThreads(8, [](int64_t) { throw std::bad_alloc(); }), std::bad_alloc);
}

TEST(ParallelFor, RunsHereWhatHasNoThread) {
  const testing::NoThreads none;
  std::vector<int64_t> ran;  // by this thread alone, so it needs no lock
  RunOnThreads(6, [&](int64_t range) { ran.push_back(range); });  // no crew of six waits
  EXPECT_EQ(ran, (std::vector<int64_t>{0, 1, 2, 3, 4, 5}));
  EXPECT_EQ(CountStartableThreads(4), 1);
}

TEST(ParallelFor, StartsNoThreadTwice) {
  std::set<std::thread::id> ids;
  std::mutex mutex;
  for (int run = 0; run < 200; ++run) {
    std::vector<int> calls(3, 0);
    RunOnThreads(3, [&](int64_t range) {
      ++calls[range];
      const std::lock_guard<std::mutex> lock(mutex);
      ids.insert(std::this_thread::get_id());
    });
    EXPECT_EQ(calls, std::vector<int>(3, 1));
  }
  EXPECT_LE(ids.size(), 3u);
}

TEST(ParallelFor, RunsWithinARun) {
  std::atomic<int> ran{0};
  RunOnThreads(3, [&](int64_t) { RunOnThreads(3, [&](int64_t) { ++ran; }); });
  EXPECT_EQ(ran, 9);
}

TEST(ParallelFor, CountsThreadsThatStart) {
  EXPECT_EQ(CountStartableThreads(3), 3);
  EXPECT_EQ(CountStartableThreads(1), 1);
}

}  // namespace
}  // namespace bundle
