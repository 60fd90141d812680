#include "core/parallel/crew.h"

#include <gtest/gtest.h>
#ifdef __linux__
#include <sched.h>
#include <sys/wait.h>
#include <unistd.h>
#endif

#include <algorithm>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <iterator>
#include <mutex>
#include <thread>
#include <vector>

#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

#ifdef __has_feature  // clang
constexpr bool kUnderThreadSanitizer = __has_feature(thread_sanitizer);
#elif defined(__SANITIZE_THREAD__)  // g++
constexpr bool kUnderThreadSanitizer = true;
#else
constexpr bool kUnderThreadSanitizer = false;
#endif

/// Ids of all threads of a pool, sorted. Each thread waits for the others, so that none does the
/// work of two.
std::vector<std::thread::id> IdsOf(ThreadPool* pool) {
  std::vector<std::thread::id> ids;
  std::mutex mutex;
  std::atomic<int> present{0};
  while (static_cast<int>(ids.size()) != pool->num_threads()) {
    ids.clear();
    present = 0;
    pool->Run([&](int) {
      ++present;
      for (int k = 0; k < 100000 && present < pool->num_threads(); ++k) std::this_thread::yield();
      const std::lock_guard<std::mutex> lock(mutex);
      const std::thread::id id = std::this_thread::get_id();
      if (std::find(ids.begin(), ids.end(), id) == ids.end()) ids.push_back(id);
    });
  }
  std::sort(ids.begin(), ids.end());
  return ids;
}

std::vector<std::thread::id> IdsOfNewPool(int num_threads) {
  ThreadPool pool(num_threads);
  return IdsOf(&pool);
}

TEST(Crew, ThreadsServePoolAfterPool) {
  const std::vector<std::thread::id> first = IdsOfNewPool(3);
  EXPECT_EQ(IdsOfNewPool(3), first);
  EXPECT_EQ(IdsOfNewPool(2).size(), 2);
  EXPECT_EQ(IdsOfNewPool(3).size(), 3);
}

TEST(Crew, PoolsAtTheSameTimeShareNoThread) {
  ThreadPool first(3), second(3);
  std::vector<std::thread::id> ids = IdsOf(&first);
  for (const std::thread::id id : IdsOf(&second)) ids.push_back(id);
  std::sort(ids.begin(), ids.end());
  EXPECT_EQ(std::unique(ids.begin(), ids.end()) - ids.begin(), 5);  // the caller is in both
}

TEST(Crew, SuitsItsNumberOfThreads) {
  const Crew crew(2);
  EXPECT_TRUE(crew.Suits(2));
  EXPECT_FALSE(crew.Suits(3));
  EXPECT_TRUE(crew.IsOfThisProcess());
}

#ifdef __linux__
TEST(Crew, AffinityChosenLaterIsObeyed) {
  cpu_set_t before, one;
  ASSERT_EQ(sched_getaffinity(0, sizeof before, &before), 0);
  if (CPU_COUNT(&before) < 2) GTEST_SKIP() << "one processor";
  IdsOfNewPool(2);
  CPU_ZERO(&one);
  CPU_SET(sched_getcpu(), &one);
  ASSERT_EQ(sched_setaffinity(0, sizeof one, &one), 0);
  std::vector<int> counts(2, 0);
  {
    ThreadPool pool(2);
    pool.Run([&](int thread) {
      cpu_set_t seen;
      sched_getaffinity(0, sizeof seen, &seen);
      counts[thread] = CPU_COUNT(&seen);
    });
  }
  ASSERT_EQ(sched_setaffinity(0, sizeof before, &before), 0);
  EXPECT_EQ(counts, std::vector<int>(2, 1));
}

int CountThreads() {
  const auto tasks = std::filesystem::directory_iterator("/proc/self/task");
  return static_cast<int>(std::distance(begin(tasks), end(tasks)));
}

TEST(Crew, OneIdleCrewIsKept) {
  IdsOfNewPool(2);  // ends an idle crew of another size
  const int before = CountThreads();
  {
    ThreadPool first(2), second(2), third(2);
  }
  for (int k = 0; k < 1000 && CountThreads() > before; ++k) {  // a joined thread is listed a while
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(CountThreads(), before);
}

TEST(Crew, ForkStartsThreadsOfItsOwn) {
  if (kUnderThreadSanitizer) GTEST_SKIP() << "it ends a fork that starts threads";
  IdsOfNewPool(2);  // leaves an idle crew
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    alarm(20);  // ends a child that waits for threads that it does not have
    const bool all = IdsOfNewPool(2).size() == 2;
    std::_Exit(all ? 0 : 1);
  }
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0);
  EXPECT_EQ(IdsOfNewPool(2).size(), 2);
}
#endif

}  // namespace
}  // namespace bundle
