#pragma once

/// The instruction set of kernels that are compiled once for each of several.

#include <type_traits>

namespace bundle {

/// In ascending order; every other processor family has the baseline alone.
enum class InstructionSet { kBaseline, kAvx2, kAvx512 };

/// The best set that this processor has and the environment variable BUNDLE_INSTRUCTION_SET allows
/// ("avx512", "avx2" or "baseline"). Throws InputError if the variable has another value.
InstructionSet BestInstructionSet();

/// The kernels for the best set, or the best below it that the build has. `avx2` and `avx512` are
/// nullptr in builds without them.
template <typename Kernels>
const Kernels& ForBestInstructionSet(const Kernels* baseline,
                                     const std::common_type_t<Kernels>* avx2,
                                     const std::common_type_t<Kernels>* avx512) {
  const Kernels* const of_set[] = {baseline, avx2, avx512};
  int set = static_cast<int>(BestInstructionSet());
  while (of_set[set] == nullptr) --set;
  return *of_set[set];
}

/// The best of baseline::name, avx2::name and avx512::name.
#ifdef BUNDLE_AVX2
#define BUNDLE_OF_AVX2(kernels) kernels
#else
#define BUNDLE_OF_AVX2(kernels) nullptr
#endif
#ifdef BUNDLE_AVX512
#define BUNDLE_OF_AVX512(kernels) kernels
#else
#define BUNDLE_OF_AVX512(kernels) nullptr
#endif
#define BUNDLE_BEST(name)                                             \
  ForBestInstructionSet(&baseline::name, BUNDLE_OF_AVX2(&avx2::name), \
                        BUNDLE_OF_AVX512(&avx512::name))

}  // namespace bundle
