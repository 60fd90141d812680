/// Part of panel_kernels.h: choice of the instruction set.

#include "core/linear/kernels/panel_kernels.h"
#include "core/parallel/instruction_set.h"

namespace bundle {

namespace baseline {
extern const PanelKernels kPanelKernels;
}
namespace avx2 {
extern const PanelKernels kPanelKernels;
}
namespace avx512 {
extern const PanelKernels kPanelKernels;
}

const PanelKernels& SelectPanelKernels() {
  static const PanelKernels& kernels = BUNDLE_BEST(kPanelKernels);
  return kernels;
}

}  // namespace bundle
