#include "core/parallel/thread_pool.h"

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <new>
#include <system_error>
#include <utility>
#include <vector>

#include "core/parallel/crew.h"

namespace bundle {

namespace {

constexpr int kSpinsBeforeYield = 2000;

void Pause() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

/// Starts threads 1 to count - 1, or as many as possible, and returns them.
template <typename Function>
std::vector<std::thread> StartThreads(int64_t count, const Function& run) {
  std::vector<std::thread> threads;
  try {
    threads.reserve(count - 1);
    for (int64_t s = 1; s < count; ++s) {
      threads.emplace_back([&run, s] { run(s); });
      MoveElsewhere(&threads.back());
    }
  } catch (const std::system_error&) {  // the system cannot start more threads
  } catch (const std::bad_alloc&) {     // no memory for another thread
  }
  return threads;
}

}  // namespace

void SpinWait::Once() {
  if (++count_ < kSpinsBeforeYield) {
    Pause();
  } else {
    std::this_thread::yield();
  }
}

// One thread needs no crew.
ThreadPool::ThreadPool(int num_threads)
    : crew_(num_threads > 1 ? TakeCrew(num_threads) : nullptr) {}

ThreadPool::~ThreadPool() {
  if (crew_ != nullptr) ReturnCrew(std::move(crew_));
}

int ThreadPool::num_threads() const { return crew_ == nullptr ? 1 : crew_->num_threads(); }

void ThreadPool::Run(const std::function<void(int thread)>& work) {
  crew_ == nullptr ? work(0) : crew_->Run(work);
}

// On the threads of a crew, which are neither started nor joined: on a loaded machine, both take
// milliseconds. What none of them has begun when this thread is done, it does itself.
void RunOnThreads(int64_t count, const std::function<void(int64_t)>& run) {
  FirstException first;
  const auto guarded = [&](int64_t s) {
    try {
      run(s);
    } catch (...) {
      first.Keep();
    }
  };
  ThreadPool pool(static_cast<int>(count));
  pool.Run(guarded);
  for (int64_t s = pool.num_threads(); s < count; ++s) guarded(s);
  first.Rethrow();
}

int CountStartableThreads(int wanted) {
  std::mutex mutex;
  std::condition_variable wake;
  bool counted = false;  // all threads exist at the same time until then
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

namespace {

// Stored in the thread's static block, because worker threads read it, too. In a module that was
// loaded late, other thread-local variables would be allocated at this access, and a failure would
// end the process.
__attribute__((tls_model("initial-exec"))) thread_local InterruptionScope* innermost = nullptr;

}  // namespace

InterruptionScope::InterruptionScope(std::function<bool()> requested, Clock::duration between_looks)
    : requested_(std::move(requested)),
      between_looks_(between_looks),
      outer_(std::exchange(innermost, this)) {}

InterruptionScope::~InterruptionScope() { innermost = outer_; }

bool InterruptionRequested() {
  InterruptionScope* const scope = innermost;
  if (scope == nullptr) return false;
  const auto now = InterruptionScope::Clock::now();
  if (!scope->is_requested_ && now >= scope->next_look_) {
    scope->is_requested_ = scope->requested_();
    scope->next_look_ = now + scope->between_looks_;
  }
  return scope->is_requested_;
}

void ThrowIfInterrupted() {
  if (InterruptionRequested()) throw Interrupted();
}

}  // namespace bundle
