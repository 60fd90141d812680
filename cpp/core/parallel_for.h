#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <thread>

namespace bundle {

/// All cores where the user did not say.
inline int EffectiveNumThreads(int num_threads) {
  if (num_threads > 0) return num_threads;
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

/// Calls run(0) to run(count - 1), each on a thread of its own as far as the system has threads,
/// the others here. Waits for all; then throws the first exception of any.
void RunOnThreads(int64_t count, const std::function<void(int64_t)>& run);

/// How many threads, up to `wanted`, the system starts at the moment; the caller's counts.
int CountStartableThreads(int wanted);

/// Calls function(begin, end) on consecutive slices of [0, count), one per thread. Ranges below
/// `min_slice` are not worth a thread and run here. Exceptions as in RunOnThreads.
template <typename Function>
void ParallelFor(int64_t count, int num_threads, const Function& function,
                 int64_t min_slice = 10000) {
  const int64_t slices =
      std::clamp<int64_t>(count / min_slice, 1, EffectiveNumThreads(num_threads));
  if (slices == 1) return function(int64_t{0}, count);
  // Quotient and remainder apart: count * s may be beyond 64 bits.
  const int64_t each = count / slices, rest = count % slices;
  const auto begin = [&](int64_t s) { return each * s + rest * s / slices; };
  RunOnThreads(slices, [&](int64_t s) { function(begin(s), begin(s + 1)); });
}

}  // namespace bundle
