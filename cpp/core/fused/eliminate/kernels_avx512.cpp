#define BUNDLE_ISA avx512
#define BUNDLE_LANES 8
#include "core/fused/eliminate/kernels_impl.h"

namespace bundle::fused::avx512 {

extern constexpr Kernels kKernels = MakeKernels("avx512");

}  // namespace bundle::fused::avx512
