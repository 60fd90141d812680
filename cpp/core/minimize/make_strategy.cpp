#include "core/minimize/make_strategy.h"

#include "core/error.h"
#include "core/minimize/dogleg.h"
#include "core/minimize/levenberg_marquardt.h"

namespace bundle {

std::unique_ptr<Strategy> MakeStrategy(const SolveOptions& options) {
  const double initial_radius = options.initial_trust_region_radius;
  switch (options.trust_region_strategy_type) {
    case TrustRegionStrategy::kLevenbergMarquardt:
      return std::make_unique<LevenbergMarquardt>(initial_radius, options.max_trust_region_radius);
    case TrustRegionStrategy::kDogleg:
      return std::make_unique<Dogleg>(TraditionalDogleg, initial_radius);
    case TrustRegionStrategy::kSubspaceDogleg:
      return std::make_unique<Dogleg>(SubspaceDogleg, initial_radius);
  }
  throw InputError("trust_region_strategy_type: expected a strategy");
}

}  // namespace bundle
