#pragma once

/// Worker threads that wait for work. They outlive a solve: starting and joining threads takes
/// longer than a small solve.

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "core/parallel/thread_pool.h"

namespace bundle {

/// Id of this process, which a fork does not share.
int64_t ProcessId();

/// Moves a thread, just started or woken, off this thread's processor. In a virtual machine,
/// Linux often puts it there although another one is idle, and balances its processors only after
/// milliseconds: a small solve would end before its threads run.
void MoveElsewhere(std::thread* thread);

/// Threads that run the same function at the same time; the caller of Run is one of them.
class Crew {
 public:
  /// Has fewer threads if the system cannot start as many.
  explicit Crew(int num_threads);
  ~Crew();
  Crew(const Crew&) = delete;
  Crew& operator=(const Crew&) = delete;

  int num_threads() const { return static_cast<int>(workers_.size()) + 1; }

  /// See ThreadPool::Run.
  void Run(const std::function<void(int thread)>& work);

  /// True if it has `num_threads` threads, the caller's included, which may use the processors that
  /// the caller may use now: a thread takes over the affinity of the thread that starts it.
  bool Suits(int num_threads) const;

  /// True in the process that started the threads; another one must not join them.
  bool IsOfThisProcess() const;

 private:
  void WorkerLoop(int thread);
  /// Lets the threads that are awake begin; true if some are asleep.
  bool StartRun();
  /// True for the first caller in a run: only that one may do the work of the thread.
  bool Claim(int thread, int64_t generation);
  void Work(const std::function<void(int thread)>& work, int thread);

  const int64_t process_;                        ///< id of the process that started the threads
  const std::vector<unsigned char> processors_;  ///< the caller's affinity at the start
  std::vector<std::atomic<int64_t>> claimed_;    ///< by thread: latest run whose work was started
  std::vector<std::thread> workers_;
  const std::function<void(int)>* work_ = nullptr;
  std::atomic<int64_t> generation_{0};  ///< number of runs; -1 ends the threads
  std::atomic<int> unfinished_{0};
  std::mutex mutex_;
  std::condition_variable wake_;
  int num_asleep_ = 0;  ///< threads that wait for `wake_`; guarded by mutex_
  FirstException first_exception_;
};

/// Returns the idle crew of this process if it suits, otherwise a new one.
std::unique_ptr<Crew> TakeCrew(int num_threads);

/// Keeps the crew for the next TakeCrew. One idle crew is kept; an earlier one ends.
void ReturnCrew(std::unique_ptr<Crew> crew);

}  // namespace bundle
