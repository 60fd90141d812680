#pragma once

#include "core/blas_threads.h"

namespace bundle {

/// Settings that belong to the whole process, held while Ceres runs and given back afterwards: its
/// log prints nothing (the summary says it), and OpenBLAS uses `blas_threads` threads.
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
