/// Part of kernels.h.
///
/// Choice of the instruction set of the kernels. A build contains the kernels for all instruction
/// sets of its processor family, so that one binary is fast on each machine.

#include "core/parallel/instruction_set.h"
#include "core/schur/kernels/kernels.h"

namespace bundle {

namespace baseline {
extern const Kernels kKernels;
}
#ifdef BUNDLE_X86_KERNELS
namespace avx2 {
extern const Kernels kKernels;
}
namespace avx512 {
extern const Kernels kKernels;
}
#endif

const Kernels& SelectKernels() {
#ifdef BUNDLE_X86_KERNELS
  static const Kernels& kernels =
      ForBestInstructionSet(&baseline::kKernels, &avx2::kKernels, &avx512::kKernels);
#else
  static const Kernels& kernels =
      ForBestInstructionSet<Kernels>(&baseline::kKernels, nullptr, nullptr);
#endif
  return kernels;
}

}  // namespace bundle
