#include "core/fused/minimize/strategy.h"

#include "core/error.h"
#include "core/fused/minimize/dogleg.h"
#include "core/fused/minimize/dogleg_path.h"
#include "core/fused/minimize/levenberg_marquardt.h"

namespace bundle::fused {

std::unique_ptr<Strategy> MakeStrategy(TrustRegionStrategy type) {
  switch (type) {
    case TrustRegionStrategy::kLevenbergMarquardt:
      return std::make_unique<LevenbergMarquardt>();
    case TrustRegionStrategy::kDogleg:
      return std::make_unique<Dogleg>(TraditionalDogleg);
    case TrustRegionStrategy::kSubspaceDogleg:
      return std::make_unique<Dogleg>(SubspaceDogleg);
  }
  throw InputError("trust_region_strategy_type: expected a strategy");
}

}  // namespace bundle::fused
