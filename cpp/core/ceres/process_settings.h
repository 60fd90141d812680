#pragma once

namespace bundle {

/// Settings that belong to the whole process, held while a solve runs and given back afterwards:
/// glog prints nothing (what it would say is in the summary), and OpenBLAS uses `blas_threads`
/// threads, because its idle threads spin and take the cores from ours. Solves that overlap share
/// the settings of the first.
class ProcessSettings {
 public:
  explicit ProcessSettings(int blas_threads);
  ~ProcessSettings();
  ProcessSettings(const ProcessSettings&) = delete;
  ProcessSettings& operator=(const ProcessSettings&) = delete;
};

}  // namespace bundle
