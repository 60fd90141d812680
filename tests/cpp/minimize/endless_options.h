#pragma once

#include "core/interface/options.h"

namespace bundle {

inline constexpr TrustRegionStrategy kStrategies[] = {TrustRegionStrategy::kLevenbergMarquardt,
                                                      TrustRegionStrategy::kDogleg,
                                                      TrustRegionStrategy::kSubspaceDogleg};

/// Options under which only the limit of iterations ends a solve.
inline SolveOptions Endless(
    TrustRegionStrategy strategy = TrustRegionStrategy::kLevenbergMarquardt) {
  SolveOptions options;
  options.trust_region_strategy_type = strategy;
  options.function_tolerance = 0;
  options.gradient_tolerance = 0;
  options.parameter_tolerance = 0;
  return options;
}

}  // namespace bundle
