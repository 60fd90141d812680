#include "core/parallel/thread_pool.h"

#include <gtest/gtest.h>
#ifdef __linux__
#include <sched.h>
#endif

#include <atomic>
#include <chrono>
#include <new>
#include <stdexcept>
#include <string>
#include <thread>
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

TEST(ThreadPool, CallsTheWorkOfEachThreadOnce) {
  for (const int num_threads : {1, 2, 3, 8}) {
    ThreadPool pool(num_threads);
    std::vector<int> calls(num_threads, 0);
    for (int run = 0; run < 5000; ++run) {
      pool.Run([&](int thread) {
        EXPECT_EQ(calls[thread], run);
        ++calls[thread];
      });
    }
    EXPECT_EQ(calls, std::vector<int>(num_threads, 5000));
  }
}

#ifdef __linux__
TEST(ThreadPool, ThreadsKeepTheProcessorsOfTheCaller) {
  cpu_set_t own, other;
  ASSERT_EQ(sched_getaffinity(0, sizeof own, &own), 0);
  CPU_ZERO(&other);
  std::atomic<bool> is_known{false};
  const std::thread::id caller = std::this_thread::get_id();
  ThreadPool pool(2);
  pool.Run([&](int) {
    if (std::this_thread::get_id() == caller) {
      while (!is_known) std::this_thread::yield();
    } else {
      // The caller moves a woken thread off its own processor first, and then lets it go.
      for (int tries = 0; tries < 10000 && !CPU_EQUAL(&own, &other); ++tries) {
        sched_getaffinity(0, sizeof other, &other);
        std::this_thread::yield();
      }
      is_known = true;
    }
  });
  EXPECT_TRUE(CPU_EQUAL(&own, &other));
}
#endif

TEST(ThreadPool, DoesNotWaitForAThreadThatHasNotStarted) {
  ThreadPool pool(2);
  bool is_by_caller = false;
  for (int run = 0; run < 1000 && !is_by_caller; ++run) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));  // then the other thread sleeps
    std::thread::id by;
    pool.Run([&](int thread) {
      if (thread == 1) by = std::this_thread::get_id();
    });
    is_by_caller = by == std::this_thread::get_id();
  }
  EXPECT_TRUE(is_by_caller);
}

TEST(ThreadPool, MakesDoWithTheThreadsThereAre) {
  const testing::NoThreads none;
  ThreadPool pool(5);
  EXPECT_EQ(pool.num_threads(), 1);
  std::vector<int> ran;
  pool.Run([&](int thread) { ran.push_back(thread); });
  EXPECT_EQ(ran, std::vector<int>{0});
}

}  // namespace
}  // namespace bundle
