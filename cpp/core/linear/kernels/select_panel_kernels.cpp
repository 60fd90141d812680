/// Part of panel_kernels.h.
///
/// Choice of the instruction set.

#include "core/linear/kernels/panel_kernels.h"
#include "core/parallel/instruction_set.h"

namespace bundle {

namespace baseline {
extern const PanelKernels kPanelKernels;
}
#ifdef BUNDLE_X86_KERNELS
namespace avx2 {
extern const PanelKernels kPanelKernels;
}
namespace avx512 {
extern const PanelKernels kPanelKernels;
}
#endif

const PanelKernels& SelectPanelKernels() {
#ifdef BUNDLE_X86_KERNELS
  static const PanelKernels& kernels =
      ForBestInstructionSet(&baseline::kPanelKernels, &avx2::kPanelKernels, &avx512::kPanelKernels);
#else
  static const PanelKernels& kernels =
      ForBestInstructionSet<PanelKernels>(&baseline::kPanelKernels, nullptr, nullptr);
#endif
  return kernels;
}

}  // namespace bundle
