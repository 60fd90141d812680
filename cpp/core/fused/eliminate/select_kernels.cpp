/// Which instruction set the passes run on. Every build holds all that its processor family knows,
/// so that one binary serves every machine at its best.

#include <cstdlib>
#include <string_view>

#include "core/fused/eliminate/kernels.h"

namespace bundle::fused {

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

namespace {

const Kernels& Select() {
#ifdef BUNDLE_X86_KERNELS
  __builtin_cpu_init();
  const char* const variable = std::getenv("BUNDLE_INSTRUCTION_SET");
  const std::string_view at_most = variable == nullptr ? "avx512" : variable;
  if (at_most != "baseline" && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) {
    const bool wide = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                      __builtin_cpu_supports("avx512dq");
    return wide && at_most != "avx2" ? avx512::kKernels : avx2::kKernels;
  }
#endif
  return baseline::kKernels;
}

}  // namespace

const Kernels& SelectKernels() {
  static const Kernels& kernels = Select();
  return kernels;
}

}  // namespace bundle::fused
