#include "core/parallel/thread_pool.h"

#include <gtest/gtest.h>

#include <atomic>
#include <new>
#include <stdexcept>
#include <string>
#include <vector>

#include "support/no_threads.h"

namespace bundle {
namespace {

TEST(ThreadPool, ThrowsWhatAThreadThrewAndRunsAgain) {
  ThreadPool pool(4);
  ASSERT_EQ(pool.num_threads(), 4);
  for (int bad = 0; bad < 4; ++bad) {
    std::atomic<int> ran{0};
    try {
      pool.Run([&](int thread) {
        ++ran;
        if (thread == bad) throw std::runtime_error("thread " + std::to_string(thread));
      });
      FAIL() << "nothing was thrown";
    } catch (const std::runtime_error& error) {
      EXPECT_EQ(error.what(), "thread " + std::to_string(bad));
    }
    EXPECT_EQ(ran, 4);
    ran = 0;
    pool.Run([&](int) { ++ran; });  // neither lost threads nor an exception of before
    EXPECT_EQ(ran, 4);
  }
  EXPECT_THROW(pool.Run([](int) { throw std::bad_alloc(); }), std::bad_alloc);
}

TEST(ThreadPool, MakesDoWithTheThreadsThereAre) {
  const testing::NoThreads none;
  ThreadPool pool(4);
  EXPECT_EQ(pool.num_threads(), 1);
  std::vector<int> ran;
  pool.Run([&](int thread) { ran.push_back(thread); });
  EXPECT_EQ(ran, std::vector<int>{0});
}

}  // namespace
}  // namespace bundle
