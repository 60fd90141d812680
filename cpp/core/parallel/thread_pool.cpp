#include "core/parallel/thread_pool.h"

#ifdef __linux__
#include <pthread.h>
#include <sched.h>
#endif

#include <algorithm>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <new>
#include <system_error>
#include <utility>
#include <vector>

namespace bundle {

namespace {

constexpr std::chrono::microseconds kStayAwake{200};
constexpr int kSpinsBeforeYield = 2000;

void Pause() {
#if defined(__x86_64__) || defined(__i386__)
  __builtin_ia32_pause();
#elif defined(__aarch64__)
  asm volatile("yield");
#endif
}

/// Moves a thread that was started or woken off this thread's processor. In a virtual machine,
/// Linux often puts it there although another one is idle, and balances its processors only after
/// milliseconds: a small solve would end before its threads run.
void MoveElsewhere(std::thread* thread) {
#ifdef __linux__
  cpu_set_t allowed;
  const pthread_t handle = thread->native_handle();
  if (pthread_getaffinity_np(handle, sizeof allowed, &allowed) != 0) return;
  cpu_set_t others = allowed;
  CPU_CLR(sched_getcpu(), &others);
  if (CPU_COUNT(&others) == 0) return;
  pthread_setaffinity_np(handle, sizeof others, &others);
  pthread_setaffinity_np(handle, sizeof allowed, &allowed);
#else
  static_cast<void>(thread);
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

ThreadPool::ThreadPool(int num_threads) : claimed_(std::max(1, num_threads)) {
  try {
    workers_.reserve(std::max(0, num_threads - 1));
    for (int thread = 1; thread < num_threads; ++thread) {
      workers_.emplace_back([this, thread] { WorkerLoop(thread); });
      MoveElsewhere(&workers_.back());
    }
  } catch (const std::system_error&) {  // the system cannot start more threads
  } catch (const std::bad_alloc&) {     // no memory for another thread
  }
}

ThreadPool::~ThreadPool() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    generation_.store(-1, std::memory_order_release);
  }
  wake_.notify_all();
  for (std::thread& worker : workers_) worker.join();
}

void ThreadPool::Run(const std::function<void(int thread)>& work) {
  if (!workers_.empty()) {
    work_ = &work;
    unfinished_.store(static_cast<int>(workers_.size()), std::memory_order_relaxed);
    const std::lock_guard<std::mutex> lock(mutex_);
    generation_.fetch_add(1, std::memory_order_release);
    if (num_asleep_ > 0) {
      wake_.notify_all();
      for (std::thread& worker : workers_) MoveElsewhere(&worker);
    }
  }
  Work(work, 0);
  const int64_t generation = generation_.load(std::memory_order_relaxed);
  for (int thread = 1; thread < num_threads(); ++thread) {
    if (!Claim(thread, generation)) continue;
    Work(work, thread);
    unfinished_.fetch_sub(1, std::memory_order_relaxed);
  }
  for (SpinWait wait; unfinished_.load(std::memory_order_acquire) > 0;) wait.Once();
  first_exception_.Rethrow();
}

bool ThreadPool::Claim(int thread, int64_t generation) {
  int64_t previous = generation - 1;  // each run's work of each thread is claimed
  return claimed_[thread].compare_exchange_strong(previous, generation, std::memory_order_acq_rel);
}

void ThreadPool::Work(const std::function<void(int thread)>& work, int thread) {
  try {
    work(thread);
  } catch (...) {
    first_exception_.Keep();
  }
}

void ThreadPool::WorkerLoop(int thread) {
  for (int64_t seen = 0;;) {
    const auto asleep_at = std::chrono::steady_clock::now() + kStayAwake;
    int64_t generation = generation_.load(std::memory_order_acquire);
    for (SpinWait wait; generation == seen && std::chrono::steady_clock::now() < asleep_at;) {
      wait.Once();
      generation = generation_.load(std::memory_order_acquire);
    }
    if (generation == seen) {
      std::unique_lock<std::mutex> lock(mutex_);
      ++num_asleep_;
      wake_.wait(lock, [&] { return generation_.load(std::memory_order_acquire) != seen; });
      --num_asleep_;
      generation = generation_.load(std::memory_order_acquire);
    }
    if (generation < 0) return;
    seen = generation;
    if (!Claim(thread, generation)) continue;
    Work(*work_, thread);
    unfinished_.fetch_sub(1, std::memory_order_release);
  }
}

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
