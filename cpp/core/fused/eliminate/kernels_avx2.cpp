#define BUNDLE_ISA avx2
#define BUNDLE_LANES 4
#include "core/fused/eliminate/kernels_impl.h"

namespace bundle::fused::avx2 {

extern constexpr Kernels kKernels = MakeKernels("avx2+fma");

}  // namespace bundle::fused::avx2
