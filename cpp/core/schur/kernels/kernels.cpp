/// The passes of kernels.h, for one instruction set. This file is compiled once for each of them,
/// with BUNDLE_ISA, the name of the namespace, BUNDLE_ISA_NAME, what reports call it, and
/// BUNDLE_LANES, the doubles of a register.
///
///   eliminate_chunk.h   linearises and eliminates,   eliminate_point.h   what a point adds
///   back_substitute.h   substitutes back and evaluates what follows
///   survey_points.h     sums over points, for covariances,   point_covariances.h   of points
///   point_block.h       the 3x3 blocks of points
///   strip.h             the walk through a chunk, and residuals several at a time
///   project_lanes.h     camera models and losses,   pack.h   registers
///
/// No array of the size of the Jacobian is stored. A pass reads each observation once: 20 bytes of
/// image and measurement, 2 bytes for its place in the chunk and 2 bytes per pair. A point takes 24
/// bytes of coordinates and 24 bytes of scaling.

#include "core/schur/kernels/back_substitute.h"
#include "core/schur/kernels/eliminate_chunk.h"
#include "core/schur/kernels/point_covariances.h"
#include "core/schur/kernels/survey_points.h"

namespace bundle::BUNDLE_ISA {

inline int64_t MemoryDoubles(const EliminationInput& input) {
  const int record = kRecordHead + 2 * input.num_columns;
  return (kMixedStripObservations + input.longest_track) *
             static_cast<int64_t>(record > kStepRecord ? record : kStepRecord) +
         3 * input.longest_track * input.num_columns;
}

extern constexpr Kernels kKernels = {
    BUNDLE_ISA_NAME, &MemoryDoubles, &Eliminate,    &EvaluateNewtonStep, &Products,
    &Cost,           &Slope,         &SurveyPoints, &PointCovariances};

}  // namespace bundle::BUNDLE_ISA
