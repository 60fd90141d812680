#include "core/ceres/process_settings.h"

#include <mutex>

#include "core/ceres/ceres_version.h"

namespace bundle {
namespace {

std::mutex mutex;
int num_holders = 0;
int saved_log_level = 0;

}  // namespace

ProcessSettings::ProcessSettings(int blas_threads) : blas_threads_(blas_threads) {
  const std::lock_guard<std::mutex> lock(mutex);
  if (num_holders++ > 0) return;
  saved_log_level = ExchangeLogLevel(kPrintNothing);
}

ProcessSettings::~ProcessSettings() {
  const std::lock_guard<std::mutex> lock(mutex);
  if (--num_holders == 0) ExchangeLogLevel(saved_log_level);
}

}  // namespace bundle
