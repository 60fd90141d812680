#include "core/parallel/instruction_set.h"

#include <algorithm>
#include <cstdlib>
#include <string>
#include <string_view>
#include <utility>

#include "core/error.h"

namespace bundle {
namespace {

/// Best instruction set that the environment allows.
InstructionSet Allowed() {
  constexpr std::pair<std::string_view, InstructionSet> kSets[] = {
      {"avx512", InstructionSet::kAvx512},
      {"avx2", InstructionSet::kAvx2},
      {"baseline", InstructionSet::kBaseline}};
  const char* const variable = std::getenv("BUNDLE_INSTRUCTION_SET");
  if (variable == nullptr || *variable == '\0') return InstructionSet::kAvx512;
  for (const auto& [name, set] : kSets) {
    if (name == variable) return set;
  }
  std::string found = variable;
  for (char& c : found) {
    if (c < ' ' || c > '~') c = '?';
  }
  throw InputError("BUNDLE_INSTRUCTION_SET: expected avx512, avx2 or baseline, found " + found);
}

InstructionSet OfProcessor() {
#ifdef BUNDLE_X86_KERNELS
  __builtin_cpu_init();
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) {
    return InstructionSet::kBaseline;
  }
  const bool wide = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
                    __builtin_cpu_supports("avx512dq");
  return wide ? InstructionSet::kAvx512 : InstructionSet::kAvx2;
#else
  return InstructionSet::kBaseline;
#endif
}

}  // namespace

InstructionSet BestInstructionSet() { return std::min(Allowed(), OfProcessor()); }

}  // namespace bundle
