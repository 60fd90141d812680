#pragma once

namespace bundle {

/// OpenBLAS' thread count, which belongs to the whole process: set while this object lives, the
/// caller's own afterwards. OpenBLAS' idle threads spin for a while and take the cores from ours,
/// so only a large factorisation is worth more than one. Those that overlap share the first's
/// count.
class ScopedBlasThreads {
 public:
  explicit ScopedBlasThreads(int num_threads);
  ~ScopedBlasThreads();
  ScopedBlasThreads(const ScopedBlasThreads&) = delete;
  ScopedBlasThreads& operator=(const ScopedBlasThreads&) = delete;
};

/// Columns of a dense matrix from which on its factorisation is worth OpenBLAS' threads.
inline constexpr int kColumnsWorthBlasThreads = 1000;

}  // namespace bundle
