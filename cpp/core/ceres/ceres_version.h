#pragma once

/// All code that differs between the supported versions of Ceres: 2.1 (Debian 12) and 2.2 (Debian
/// 13).

#include <ceres/ceres.h>
#include <glog/logging.h>

#include <utility>

#if CERES_VERSION_MAJOR < 2 || (CERES_VERSION_MAJOR == 2 && CERES_VERSION_MINOR < 1)
#error "bundle needs Ceres 2.1 or newer"
#endif

#define BUNDLE_CERES_AT_LEAST_2_2 \
  (CERES_VERSION_MAJOR > 2 || (CERES_VERSION_MAJOR == 2 && CERES_VERSION_MINOR >= 2))

namespace bundle {

/// Sets the power series expansion of the Schur complement, available since 2.2. Returns false
/// without it.
inline bool PowerSeriesPreconditioner(ceres::PreconditionerType* type) {
#if BUNDLE_CERES_AT_LEAST_2_2
  *type = ceres::SCHUR_POWER_SERIES_EXPANSION;
  return true;
#else
  (void)type;
  return false;
#endif
}

/// Below this level Ceres' log, which is glog's, prints nothing.
inline constexpr int kPrintNothing = google::GLOG_FATAL;

/// Sets the lowest level that this process logs; returns the previous level.
inline int ExchangeLogLevel(int level) { return std::exchange(FLAGS_minloglevel, level); }

}  // namespace bundle
