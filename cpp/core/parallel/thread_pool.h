#pragma once

/// Threads: loops over ranges, a pool with the lifetime of a solver, and exceptions across both.
/// Also interruption by the user: requested on the calling thread, thrown as Interrupted.

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

namespace bundle {

/// Stores the first exception of several threads.
class FirstException {
 public:
  /// Call inside a handler: stores the current exception, unless one is stored already.
  void Keep() noexcept {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!exception_) exception_ = std::current_exception();
  }

  /// Throws the stored exception, if any, and removes it. Call after all threads have ended.
  void Rethrow() {
    if (exception_) std::rethrow_exception(std::exchange(exception_, nullptr));
  }

 private:
  std::mutex mutex_;
  std::exception_ptr exception_;
};

/// Number of threads: all cores unless the user chose a number.
inline int EffectiveNumThreads(int num_threads) {
  if (num_threads > 0) return num_threads;
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

/// Calls run(0) to run(count - 1), each on its own thread if the system has enough threads; the
/// others run on this thread. Waits for all. If any call threw, then throws the earliest exception.
void RunOnThreads(int64_t count, const std::function<void(int64_t)>& run);

/// Number of threads, up to `wanted`, that the system can start now, including the caller's.
int CountStartableThreads(int wanted);

/// Begin of one of several ranges of [0, count) of about equal lengths. Quotient and remainder are
/// multiplied separately, because count * range may exceed 64 bits.
inline int64_t RangeBegin(int64_t count, int64_t num_ranges, int64_t range) {
  return count / num_ranges * range + count % num_ranges * range / num_ranges;
}

/// Calls function(begin, end) on consecutive ranges of [0, count), one per thread. Ranges below
/// `min_range` are too small for a thread and run on this one. Exceptions as in RunOnThreads.
template <typename Function>
void ParallelFor(int64_t count, int num_threads, const Function& function,
                 int64_t min_range = 10000) {
  const int64_t ranges =
      std::clamp<int64_t>(count / min_range, 1, EffectiveNumThreads(num_threads));
  if (ranges == 1) return function(int64_t{0}, count);
  const auto begin = [&](int64_t s) { return RangeBegin(count, ranges, s); };
  RunOnThreads(ranges, [&](int64_t s) { function(begin(s), begin(s + 1)); });
}

class Crew;

/// Threads for the lifetime of a solve, taken from a crew (crew.h) that outlives it. A pass of a
/// small problem takes less time than waking a thread, so they wait actively for the next pass for
/// a while.
///
/// The caller waits only for threads that have started: it does the work of the others itself. On a
/// loaded machine a thread may get a core milliseconds later, when its share has long been done.
class ThreadPool {
 public:
  /// Has fewer threads if the system cannot start as many.
  explicit ThreadPool(int num_threads);
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  int num_threads() const;

  /// Calls work(thread) once for each thread, where the caller's is thread 0, and waits for all.
  /// The caller's thread also makes the calls that no other thread has started when its own has
  /// ended, so a call must not wait for another one to start. If any call threw, then throws the
  /// earliest exception. The pool can run again afterwards.
  void Run(const std::function<void(int thread)>& work);

 private:
  std::unique_ptr<Crew> crew_;  ///< nullptr: one thread
};

/// Calls visit(number, thread) for the numbers 0 to count - 1, which the threads of the pool take
/// one after the other. nullptr: on this thread, as thread 0.
template <typename Visit>
void ForEach(ThreadPool* pool, int64_t count, const Visit& visit) {
  if (pool == nullptr || pool->num_threads() == 1 || count < 2) {
    for (int64_t number = 0; number < count; ++number) visit(number, 0);
    return;
  }
  std::atomic<int64_t> next{0};
  pool->Run([&](int thread) {
    for (int64_t k = next.fetch_add(1); k < count; k = next.fetch_add(1)) visit(k, thread);
  });
}

/// ParallelFor on the threads of a pool, which already run.
template <typename Function>
void ParallelFor(int64_t count, ThreadPool* pool, const Function& function,
                 int64_t min_range = 1000) {
  const int64_t most = pool == nullptr ? 1 : pool->num_threads();
  const int64_t ranges = std::clamp<int64_t>(count / min_range, 1, most);
  if (ranges == 1) return function(int64_t{0}, count);
  const auto begin = [&](int64_t s) { return RangeBegin(count, ranges, s); };
  ForEach(pool, ranges, [&](int64_t s, int) { function(begin(s), begin(s + 1)); });
}

/// Tells the processor that the caller waits in a loop and, after a while, yields to the system.
class SpinWait {
 public:
  void Once();

 private:
  int count_ = 0;
};

/// Exception that ends a computation at the user's request.
class Interrupted : public std::exception {
 public:
  const char* what() const noexcept override { return "interrupted"; }
};

/// During its lifetime, long computations on this thread call `requested` to check if the user
/// wants them to end, at most once per `between_looks`. After it returns true, it is not called
/// again.
///
/// It is stored per thread and not passed as an argument, which every linear solver and every pass
/// over the points would have to forward. The innermost scope counts.
class InterruptionScope {
 public:
  using Clock = std::chrono::steady_clock;

  explicit InterruptionScope(std::function<bool()> requested,
                             Clock::duration between_looks = std::chrono::milliseconds(200));
  ~InterruptionScope();
  InterruptionScope(const InterruptionScope&) = delete;
  InterruptionScope& operator=(const InterruptionScope&) = delete;

 private:
  friend bool InterruptionRequested();

  std::function<bool()> requested_;
  Clock::duration between_looks_;
  bool is_requested_ = false;
  Clock::time_point next_look_ = Clock::now();
  InterruptionScope* const outer_;
};

/// True if the user wants the computation on this thread to end; false on a thread without a scope.
/// Most calls only read the clock.
bool InterruptionRequested();

/// Throws Interrupted if the user wants the computation on this thread to end.
void ThrowIfInterrupted();

}  // namespace bundle
