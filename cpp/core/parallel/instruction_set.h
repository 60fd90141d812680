#pragma once

/// The instruction set of kernels that are compiled once for each of several.

namespace bundle {

/// In ascending order; every other processor family has the baseline alone.
enum class InstructionSet { kBaseline, kAvx2, kAvx512 };

/// The best set that this processor has and the environment variable BUNDLE_INSTRUCTION_SET allows
/// ("avx512", "avx2" or "baseline"). Throws InputError if the variable has another value.
InstructionSet BestInstructionSet();

}  // namespace bundle
