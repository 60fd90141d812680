#define BUNDLE_ISA baseline
#define BUNDLE_LANES 4
#include "core/fused/eliminate/kernels_impl.h"

namespace bundle::fused::baseline {

extern constexpr Kernels kKernels = MakeKernels("baseline");

}  // namespace bundle::fused::baseline
