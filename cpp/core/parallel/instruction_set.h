#pragma once

/// The instruction set of kernels that are compiled once for each of several.

namespace bundle {

/// In ascending order; every other processor family has the baseline alone.
enum class InstructionSet { kBaseline, kAvx2, kAvx512 };

/// The best set that this processor has and the environment variable BUNDLE_INSTRUCTION_SET allows
/// ("avx512", "avx2" or "baseline"). Throws InputError if the variable has another value.
InstructionSet BestInstructionSet();

/// The kernels for the best set of those for all three. `avx2` and `avx512` are nullptr in builds
/// for other processor families, which never choose them.
template <typename Kernels>
const Kernels& ForBestInstructionSet(const Kernels* baseline, const Kernels* avx2,
                                     const Kernels* avx512) {
  const Kernels* const of_set[] = {baseline, avx2, avx512};
  return *of_set[static_cast<int>(BestInstructionSet())];
}

}  // namespace bundle
