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

/// Makes OpenBLAS take its buffers now, 128 MiB per thread: where it cannot have one it tries for
/// ever. Where there is room for one only, OpenBLAS has one thread from then on. Throws
/// std::bad_alloc.
void TakeBlasBuffers();

/// Columns of a dense matrix from which on its factorisation is worth OpenBLAS' threads.
inline constexpr int kColumnsWorthBlasThreads = 1000;

}  // namespace bundle
