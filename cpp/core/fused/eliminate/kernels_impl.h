#pragma once

/// The passes of kernels.h, for one instruction set. Compiled by kernels_*.cpp, each of which
/// defines BUNDLE_ISA, the name of the namespace, and BUNDLE_LANES, the doubles of a register.
///
///   eliminate_chunk.h   linearises and eliminates,   eliminate_point.h   what a point adds
///   back_substitute.h   substitutes back and evaluates what follows
///   point_block.h       the 3x3 blocks of points
///   strip.h             the walk through a chunk, and residuals several at a time
///   project_lanes.h     camera models,   loss_lanes.h   losses,   pack.h   registers
///
/// Nothing of the size of the Jacobian is kept. Each observation is read once a pass: 20 bytes of
/// image and measurement, 2 of its place in the chunk, 2 a pair; a point is 24 bytes of coordinates
/// and 24 of scaling.

#include "core/fused/eliminate/back_substitute.h"
#include "core/fused/eliminate/eliminate_chunk.h"

namespace bundle::fused::BUNDLE_ISA {

inline int64_t MemoryDoubles(const Terms& terms) {
  const int record = kRecordHead + 2 * terms.num_columns;
  return (kMixedStripObservations + terms.longest_track) *
         static_cast<int64_t>(record > kStepRecord ? record : kStepRecord);
}

constexpr Kernels MakeKernels(const char* name) {
  return {name, &MemoryDoubles, &Eliminate, &TryNewton, &Products, &Cost};
}

}  // namespace bundle::fused::BUNDLE_ISA
