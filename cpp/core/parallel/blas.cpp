#include "core/parallel/blas.h"

#include <sys/mman.h>

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <limits>
#include <mutex>
#include <new>
#include <vector>

extern "C" {
int openblas_get_num_threads();
void openblas_set_num_threads(int num_threads);
}

namespace bundle {
namespace {

std::mutex mutex;
int num_holders = 0;
int saved_num_threads = 0;
std::atomic<bool> buffers_may_fail{false};
std::atomic<int> max_num_threads{std::numeric_limits<int>::max()};

// Bytes of a buffer, plus stacks of threads and the heap.
constexpr size_t kBufferBytes = size_t{136} << 20;

bool CanHave(size_t bytes) {
  void* const memory =
      mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) return false;
  munmap(memory, bytes);
  return true;
}

/// Large enough to need a buffer for each thread.
void MultiplyMatrices() {
  constexpr char kPlain = 'N';
  constexpr int kSize = 256;
  constexpr double kOne = 1, kZero = 0;
  std::vector<double> a(size_t{kSize} * kSize), b(a.size());
  dgemm_(&kPlain, &kPlain, &kSize, &kSize, &kSize, &kOne, a.data(), &kSize, a.data(), &kSize,
         &kZero, b.data(), &kSize);
}

void TakeBuffersOnce() {
  if (!CanHave(kBufferBytes)) throw std::bad_alloc();
  const int num_threads = openblas_get_num_threads();
  if (!CanHave(kBufferBytes * num_threads)) max_num_threads = 1;
  openblas_set_num_threads(std::min(num_threads, max_num_threads.load()));
  MultiplyMatrices();
  openblas_set_num_threads(num_threads);
}

}  // namespace

void TakeBlasBuffers() {
  static std::once_flag taken;
  std::call_once(taken, TakeBuffersOnce);
}

void TakeBlasBuffersAtFirstUse() { buffers_may_fail = true; }

ScopedBlasThreads::ScopedBlasThreads(int num_threads) {
  if (buffers_may_fail) TakeBlasBuffers();
  const std::lock_guard<std::mutex> lock(mutex);
  if (num_holders++ > 0) return;
  saved_num_threads = openblas_get_num_threads();
  openblas_set_num_threads(std::min(num_threads, max_num_threads.load()));
}

ScopedBlasThreads::~ScopedBlasThreads() {
  const std::lock_guard<std::mutex> lock(mutex);
  if (--num_holders == 0) openblas_set_num_threads(saved_num_threads);
}

}  // namespace bundle
