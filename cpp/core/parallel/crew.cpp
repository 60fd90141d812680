#include "core/parallel/crew.h"

/// Starting a thread takes 20 to 100 us, joining one that sleeps about as long, and on a loaded
/// machine milliseconds: a thread must get a core to end. A solve of a small model takes 1 ms.
/// Therefore the threads of a pool are not joined at its end but wait, asleep, for the next pool.

#ifdef __linux__
#include <pthread.h>
#include <sched.h>
#endif
#if __has_include(<unistd.h>)
#include <unistd.h>
#endif

#include <algorithm>
#include <chrono>
#include <new>
#include <system_error>
#include <utility>

namespace bundle {

namespace {

constexpr std::chrono::microseconds kStayAwake{200};

/// Affinity of this thread as bytes; empty where it is not known.
std::vector<unsigned char> AllowedProcessors() {
#ifdef __linux__
  cpu_set_t allowed;
  if (pthread_getaffinity_np(pthread_self(), sizeof allowed, &allowed) != 0) return {};
  const auto* const bytes = reinterpret_cast<const unsigned char*>(&allowed);
  return {bytes, bytes + sizeof allowed};
#else
  return {};
#endif
}

/// The crew that waits for the next pool. Without a mutex, which a fork could leave locked.
class IdleCrew {
 public:
  IdleCrew() = default;
  ~IdleCrew() { Exchange(nullptr); }
  IdleCrew(const IdleCrew&) = delete;
  IdleCrew& operator=(const IdleCrew&) = delete;

  std::unique_ptr<Crew> Take() { return Own(crew_.exchange(nullptr)); }
  void Exchange(std::unique_ptr<Crew> crew) { Own(crew_.exchange(crew.release())); }

 private:
  /// Leaves the crew of another process, whose memory a fork has copied, alone.
  static std::unique_ptr<Crew> Own(Crew* crew) {
    return std::unique_ptr<Crew>(crew != nullptr && crew->IsOfThisProcess() ? crew : nullptr);
  }

  std::atomic<Crew*> crew_{nullptr};
};

IdleCrew idle;

}  // namespace

#if __has_include(<unistd.h>)
int64_t ProcessId() { return getpid(); }
#else
int64_t ProcessId() { return 1; }
#endif

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

Crew::Crew(int num_threads)
    : process_(ProcessId()), processors_(AllowedProcessors()), claimed_(std::max(1, num_threads)) {
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

Crew::~Crew() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    generation_.store(-1, std::memory_order_release);
  }
  wake_.notify_all();
  for (std::thread& worker : workers_) worker.join();
}

void Crew::Run(const std::function<void(int thread)>& work) {
  if (!workers_.empty()) {
    work_ = &work;
    unfinished_.store(static_cast<int>(workers_.size()), std::memory_order_relaxed);
    if (StartRun()) {
      // Without the mutex: a woken thread that had to wait for it would be woken, and placed by the
      // system, a second time.
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

bool Crew::StartRun() {
  const std::lock_guard<std::mutex> lock(mutex_);
  generation_.fetch_add(1, std::memory_order_release);
  return num_asleep_ > 0;
}

bool Crew::Claim(int thread, int64_t generation) {
  int64_t previous = generation - 1;  // each run's work of each thread is claimed
  return claimed_[thread].compare_exchange_strong(previous, generation, std::memory_order_acq_rel);
}

void Crew::Work(const std::function<void(int thread)>& work, int thread) {
  try {
    work(thread);
  } catch (...) {
    first_exception_.Keep();
  }
}

void Crew::WorkerLoop(int thread) {
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

bool Crew::IsOfThisProcess() const { return process_ == ProcessId(); }

bool Crew::Suits(int num_threads) const {
  return this->num_threads() == num_threads && processors_ == AllowedProcessors();
}

std::unique_ptr<Crew> TakeCrew(int num_threads) {
  std::unique_ptr<Crew> crew = idle.Take();
  if (crew != nullptr && crew->Suits(num_threads)) return crew;
  return std::make_unique<Crew>(num_threads);
}

void ReturnCrew(std::unique_ptr<Crew> crew) { idle.Exchange(std::move(crew)); }

}  // namespace bundle
