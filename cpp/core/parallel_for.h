#pragma once

#include <algorithm>
#include <cstdint>
#include <thread>
#include <vector>

namespace bundle {

/// All cores where the user did not say.
inline int EffectiveNumThreads(int num_threads) {
  if (num_threads > 0) return num_threads;
  return std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
}

/// Calls function(begin, end) on consecutive slices of [0, count), one a thread. Ranges below
/// `min_slice` are not worth a thread and run here.
template <typename Function>
void ParallelFor(int64_t count, int num_threads, const Function& function,
                 int64_t min_slice = 10000) {
  const int64_t slices =
      std::clamp<int64_t>(count / min_slice, 1, EffectiveNumThreads(num_threads));
  std::vector<std::thread> threads;
  for (int64_t s = 1; s < slices; ++s) {
    threads.emplace_back(
        [&function, s, slices, count] { function(count * s / slices, count * (s + 1) / slices); });
  }
  function(0, count / slices);
  for (std::thread& thread : threads) thread.join();
}

}  // namespace bundle
