/// The passes of kernels.h, for one instruction set. This file is compiled once for each of them,
/// with BUNDLE_ISA, the name of the namespace, BUNDLE_ISA_NAME, what reports call it, and
/// BUNDLE_LANES, the doubles of a register.
///
///   eliminate_chunk.h   linearises and eliminates,   eliminate_point.h   factors of a point,
///   tile_products.h     products of a tile, block by block
///   nine_products.h     of 9 columns,   twelve_products.h   of 12 columns
///   map_block.h         maps of blocks,   add_block.h   addition to S
///   multiply_schur.h    products with S that is not formed
///   back_substitute.h   substitutes back and evaluates what follows
///   survey_points.h     sums over points, for covariances,   point_covariances.h   of points
///   point_leverages.h   leverages of observations,   point_movements.h   movements of points
///   point_block.h       the 3x3 blocks of points
///   strip.h             the walk through a chunk, and residuals several at a time
///   project_lanes.h     camera models and losses,   wide_row.h, parallel/pack.h   registers
///
/// No array of the size of the Jacobian is stored, except for products with S while it fits the
/// cache. A pass reads each observation once: 20 bytes of
/// image and measurement, 4 bytes or more for its places in chunk and tile and 4 bytes per pair. A
/// point takes 24 bytes of coordinates and 24 bytes of scaling.

#include "core/schur/kernels/add_block.h"
#include "core/schur/kernels/back_substitute.h"
#include "core/schur/kernels/eliminate_chunk.h"
#include "core/schur/kernels/map_block.h"
#include "core/schur/kernels/multiply_schur.h"
#include "core/schur/kernels/point_covariances.h"
#include "core/schur/kernels/point_leverages.h"
#include "core/schur/kernels/point_movements.h"
#include "core/schur/kernels/survey_points.h"

namespace bundle::BUNDLE_ISA {

inline int64_t MemoryDoubles(const EliminationInput& input) {
  const int64_t of_tile = TileDoubles(input);
  const int64_t of_strip = (kMixedStripObservations + input.longest_track) * kStepRecord;
  return of_tile > of_strip ? of_tile : of_strip;
}

inline int64_t ScatterDoubles(const EliminationInput& input) {
  return TileRecords::FactorDoubles(input) + ScatterMemory::NumDoubles(input);
}

extern constexpr Kernels kKernels = {
    BUNDLE_ISA_NAME, &MemoryDoubles, &ScatterDoubles, &Eliminate,    &EvaluateNewtonStep,
    &MultiplySchur,  &MultiplyKept,  &KeptDoubles,    &AddBlock,     &MapBlock,
    &Products,       &Cost,          &Slope,          &SurveyPoints, &PointCovariances,
    &PointLeverages, &PointMovements};

}  // namespace bundle::BUNDLE_ISA
