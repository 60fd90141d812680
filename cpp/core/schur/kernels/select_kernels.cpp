/// Part of kernels.h.
///
/// Choice of the instruction set of the kernels. A build contains the kernels for all instruction
/// sets of its processor family, so that one binary is fast on each machine.

#include <cstdlib>
#include <string>
#include <string_view>

#include "core/error.h"
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

namespace {

/// Best instruction set that the environment allows.
std::string_view InstructionSetAllowed() {
  constexpr std::string_view kSets[] = {"avx512", "avx2", "baseline"};
  const char* const variable = std::getenv("BUNDLE_INSTRUCTION_SET");
  if (variable == nullptr || *variable == '\0') return kSets[0];
  for (const std::string_view set : kSets) {
    if (set == variable) return set;
  }
  std::string found = variable;
  for (char& c : found) {
    if (c < ' ' || c > '~') c = '?';
  }
  throw InputError("BUNDLE_INSTRUCTION_SET: expected avx512, avx2 or baseline, found " + found);
}

const Kernels& Select() {
  [[maybe_unused]] const std::string_view at_most = InstructionSetAllowed();
#ifdef BUNDLE_X86_KERNELS
  __builtin_cpu_init();
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

}  // namespace bundle
