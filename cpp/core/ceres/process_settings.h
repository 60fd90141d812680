#pragma once

#include "core/blas_threads.h"

namespace bundle {

/// Settings that belong to the whole process, held while Ceres runs and given back afterwards: glog
/// prints nothing (what it would say is in the summary), and OpenBLAS uses `blas_threads` threads.
class ProcessSettings {
 public:
  explicit ProcessSettings(int blas_threads);
  ~ProcessSettings();
  ProcessSettings(const ProcessSettings&) = delete;
  ProcessSettings& operator=(const ProcessSettings&) = delete;

 private:
  ScopedBlasThreads blas_threads_;
};

}  // namespace bundle
