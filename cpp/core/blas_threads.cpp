#include "core/blas_threads.h"

#include <mutex>

extern "C" {
int openblas_get_num_threads();
void openblas_set_num_threads(int num_threads);
}

namespace bundle {
namespace {

std::mutex mutex;
int num_holders = 0;
int saved_num_threads = 0;

}  // namespace

ScopedBlasThreads::ScopedBlasThreads(int num_threads) {
  const std::lock_guard<std::mutex> lock(mutex);
  if (num_holders++ > 0) return;
  saved_num_threads = openblas_get_num_threads();
  openblas_set_num_threads(num_threads);
}

ScopedBlasThreads::~ScopedBlasThreads() {
  const std::lock_guard<std::mutex> lock(mutex);
  if (--num_holders == 0) openblas_set_num_threads(saved_num_threads);
}

}  // namespace bundle
