/// Part of edge_kernels.h: choice of the instruction set.

#include "core/parallel/instruction_set.h"
#include "core/pose_graph/kernels/edge_kernels.h"

namespace bundle {

#define BUNDLE_DECLARE_EDGE_KERNELS(isa)             \
  namespace isa {                                    \
  extern const EdgeKernels<Se2> kPlanarEdgeKernels;  \
  extern const EdgeKernels<Se3> kSpatialEdgeKernels; \
  }
BUNDLE_DECLARE_EDGE_KERNELS(baseline)
BUNDLE_DECLARE_EDGE_KERNELS(avx2)
BUNDLE_DECLARE_EDGE_KERNELS(avx512)

template <>
const EdgeKernels<Se2>& SelectEdgeKernels<Se2>() {
  static const EdgeKernels<Se2>& kernels = BUNDLE_BEST(kPlanarEdgeKernels);
  return kernels;
}

template <>
const EdgeKernels<Se3>& SelectEdgeKernels<Se3>() {
  static const EdgeKernels<Se3>& kernels = BUNDLE_BEST(kSpatialEdgeKernels);
  return kernels;
}

}  // namespace bundle
