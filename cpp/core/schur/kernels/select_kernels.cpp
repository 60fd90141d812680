/// Part of kernels.h: choice of the instruction set of the kernels. A build contains the kernels
/// for all instruction sets of its processor family, so that one binary is fast on each machine.

#include "core/parallel/instruction_set.h"
#include "core/schur/kernels/kernels.h"

namespace bundle {

namespace baseline {
extern const Kernels kKernels;
}
namespace avx2 {
extern const Kernels kKernels;
}
namespace avx512 {
extern const Kernels kKernels;
}

const Kernels& SelectKernels() {
  static const Kernels& kernels = BUNDLE_BEST(kKernels);
  return kernels;
}

}  // namespace bundle
