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

namespace {

const PanelKernels& Select() {
#ifdef BUNDLE_X86_KERNELS
  switch (BestInstructionSet()) {
    case InstructionSet::kAvx512:
      return avx512::kPanelKernels;
    case InstructionSet::kAvx2:
      return avx2::kPanelKernels;
    case InstructionSet::kBaseline:
      break;
  }
#endif
  return baseline::kPanelKernels;
}

}  // namespace

const PanelKernels& SelectPanelKernels() {
  static const PanelKernels& kernels = Select();
  return kernels;
}

}  // namespace bundle
