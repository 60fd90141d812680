#pragma once

/// Projection by rolling shutters, several observations at once. Included by kernels.cpp only.
///
/// factors/rolling_shutter.h, lane by lane. A lane whose row has no solution, or that does not
/// count in an iteration, does not count. A lane that has converged keeps its row time until all
/// have, so that its results do not depend on other lanes.
///
/// A step evaluates each state in two passes, and before that as a candidate. The pass of the
/// candidate stores the row times at which its iterations end (StateRecords::row_times). The others
/// begin there, end at once, and find the same numbers to the last bit.

#include "core/factors/rolling_shutter.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/kernels/project_lanes.h"

namespace bundle::BUNDLE_ISA {

/// Outputs are those of ProjectLanes, and the derivatives w.r.t. the twist (2x6); without `derive`
/// only residuals. `shutter`: twist and row scale. `row_time`: where the iteration begins (NaN: at
/// the measured row), and then where it ended (NaN: it did not). No output may be nullptr, as all
/// serve as memory.
inline void ProjectByRow(const ModelGroup& group, const Pack* params, const Pack* shutter,
                         bool at_observed_row, const Pack* camera_point, const Pack* measurement,
                         Cheirality cheirality, bool derive, Pack* row_time, Pack* residual,
                         Pack* d_point, Pack* d_params, Pack* d_twist, Mask* counts,
                         int num_lanes) {
  const Pack* const g = shutter + kTwistSize;
  const Pack measured = g[0] * measurement[0] + g[1] * measurement[1] - 0.5;
  Pack s = Select(*row_time <= *row_time, *row_time, measured), by_point[6], carry[2] = {0.0, 0.0};
  Mask valid = measured <= measured;
  for (int count = 0; count < kMaxRowSteps; ++count) {
    const MovedPoint<Pack> moved(shutter, s, camera_point);
    Mask seen;
    kProjectLanes[group.model](AllCameraModels()[group.model], params, moved.point, measurement,
                               cheirality, residual, by_point, d_params, &seen, num_lanes);
    valid = valid & seen & (moved.turn_squared <= kMaxRowTurnSquared);
    if (!at_observed_row) {
      const Pack speed[2] = {DotOf(by_point, moved.velocity), DotOf(by_point + 3, moved.velocity)};
      const Pack slope = 1 - (g[0] * speed[0] + g[1] * speed[1]);
      valid = valid & (slope > 0);
      const Pack step =
          (g[0] * residual[0] + g[1] * residual[1] + measured - s) / Select(valid, slope, 1.0);
      const Mask small = (step <= kLastRowStep) & (step >= -kLastRowStep);
      if (!All(small | ~valid) && count + 1 < kMaxRowSteps) {
        s = Select(valid, Select(small, s, s + step), measured);
        continue;
      }
      valid = valid & small;
      *row_time = Select(valid, s, __builtin_nan(""));
      for (int i = 0; i < 2; ++i) {
        residual[i] += speed[i] * step;
        carry[i] = speed[i] / Select(valid, slope, 1.0);
      }
      s = s + step;
    }
    if (!derive) break;
    CarryRows(carry, g, 3, by_point);
    CarryRows(carry, g, group.num_params, d_params);
    Pack by_turn[9];
    moved.ByTurn(by_turn);
    for (int row = 0; row < 2; ++row) {
      moved.RowByStart(by_point + 3 * row, d_point + 3 * row);
      moved.RowByTwist(by_turn, by_point + 3 * row, s, d_twist + kTwistSize * row);
    }
    break;
  }
  *counts = valid;
  if (All(valid)) return;
  ZeroUncounted(valid, residual, 2);
  if (!derive) return;
  ZeroUncounted(valid, d_point, 6);
  ZeroUncounted(valid, d_params, 2 * group.num_params);
  ZeroUncounted(valid, d_twist, 2 * kTwistSize);
}

}  // namespace bundle::BUNDLE_ISA
