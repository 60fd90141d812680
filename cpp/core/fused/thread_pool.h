#pragma once

#include <atomic>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

#include "core/first_exception.h"

namespace bundle::fused {

/// Threads that live as long as a solve. A pass of a small problem takes less time than starting a
/// thread does, so they wait for the next one awake, for a while.
class ThreadPool {
 public:
  /// Has fewer threads where the system does not start as many.
  explicit ThreadPool(int num_threads);
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  int num_threads() const { return static_cast<int>(workers_.size()) + 1; }

  /// Calls work(thread) once on each thread, the caller's being thread 0, and waits for all. Then
  /// throws the first exception of any; the pool can run again.
  void Run(const std::function<void(int thread)>& work);

 private:
  void WorkerLoop(int thread);
  void Work(const std::function<void(int thread)>& work, int thread);

  std::vector<std::thread> workers_;
  const std::function<void(int)>* work_ = nullptr;
  std::atomic<int> generation_{0};  ///< counts the runs; -1 ends the threads
  std::atomic<int> unfinished_{0};
  std::mutex mutex_;
  std::condition_variable wake_;
  FirstException first_exception_;
};

/// Tells the processor that the caller waits in a loop, and the system after a while.
class SpinWait {
 public:
  void Once();

 private:
  int count_ = 0;
};

}  // namespace bundle::fused
