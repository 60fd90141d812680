#include "core/parallel_for.h"

#include <condition_variable>
#include <mutex>
#include <new>
#include <system_error>
#include <vector>

#include "core/first_exception.h"

namespace bundle {
namespace {

/// Starts threads 1 to count - 1, or as many as there are, and returns them.
template <typename Function>
std::vector<std::thread> StartThreads(int64_t count, const Function& run) {
  std::vector<std::thread> threads;
  try {
    threads.reserve(count - 1);
    for (int64_t s = 1; s < count; ++s) threads.emplace_back([&run, s] { run(s); });
  } catch (const std::system_error&) {  // the system has no more threads
  } catch (const std::bad_alloc&) {     // or no memory for one
  }
  return threads;
}

}  // namespace

void RunOnThreads(int64_t count, const std::function<void(int64_t)>& run) {
  FirstException first;
  const auto guarded = [&](int64_t s) {
    try {
      run(s);
    } catch (...) {
      first.Keep();
    }
  };
  std::vector<std::thread> threads = StartThreads(count, guarded);
  guarded(0);
  for (auto s = static_cast<int64_t>(threads.size()) + 1; s < count; ++s) guarded(s);
  for (std::thread& thread : threads) thread.join();
  first.Rethrow();
}

int CountStartableThreads(int wanted) {
  std::mutex mutex;
  std::condition_variable wake;
  bool counted = false;  // all exist at the same time until then
  const auto wait = [&](int64_t) {
    std::unique_lock<std::mutex> lock(mutex);
    wake.wait(lock, [&] { return counted; });
  };
  std::vector<std::thread> threads = StartThreads(wanted, wait);
  {
    const std::lock_guard<std::mutex> lock(mutex);
    counted = true;
  }
  wake.notify_all();
  for (std::thread& thread : threads) thread.join();
  return static_cast<int>(threads.size()) + 1;
}

}  // namespace bundle
