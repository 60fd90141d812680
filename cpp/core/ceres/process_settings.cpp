#include "core/ceres/process_settings.h"

#include <glog/logging.h>

#include <mutex>

extern "C" {
int openblas_get_num_threads();
void openblas_set_num_threads(int num_threads);
}

namespace bundle {
namespace {

std::mutex mutex;
int num_holders = 0;
int saved_blas_threads = 0;
int saved_log_level = 0;

}  // namespace

ProcessSettings::ProcessSettings(int blas_threads) {
  const std::lock_guard<std::mutex> lock(mutex);
  if (num_holders++ > 0) return;
  saved_blas_threads = openblas_get_num_threads();
  saved_log_level = FLAGS_minloglevel;
  openblas_set_num_threads(blas_threads);
  FLAGS_minloglevel = google::GLOG_FATAL;
}

ProcessSettings::~ProcessSettings() {
  const std::lock_guard<std::mutex> lock(mutex);
  if (--num_holders > 0) return;
  openblas_set_num_threads(saved_blas_threads);
  FLAGS_minloglevel = saved_log_level;
}

}  // namespace bundle
