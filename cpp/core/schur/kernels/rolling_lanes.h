#pragma once

/// Projection by rolling shutters, several observations at once. Included by kernels.cpp only.
///
/// factors/rolling_shutter.h, lane by lane. A lane whose row has no solution, or that does not
/// count in an iteration, does not count. Lanes that have converged go on until all have: their
/// further steps are rounding errors.

#include "core/factors/rolling_shutter.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/kernels/project_lanes.h"

namespace bundle::BUNDLE_ISA {

/// Outputs are those of ProjectLanes, and the derivatives by the twist (2x6). `shutter`: twist and
/// row scale. All outputs are needed as memory.
inline void ProjectByRow(const ModelGroup& group, const Pack* params, const Pack* shutter,
                         bool at_observed_row, const Pack* camera_point, const Pack* measurement,
                         Cheirality cheirality, Pack* residual, Pack* d_point, Pack* d_params,
                         Pack* d_twist, Mask* counts, int num_lanes) {
  const Pack* const g = shutter + kTwistSize;
  const Pack measured = g[0] * measurement[0] + g[1] * measurement[1] - 0.5;
  Pack s = measured, by_point[6], carry[2] = {0.0, 0.0};
  Mask valid = measured <= measured;
  bool is_found = at_observed_row;
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
      is_found = All(small | ~valid);
      if (!is_found && count + 1 < kMaxRowSteps) {
        s = Select(valid, s + step, measured);
        continue;
      }
      valid = valid & small;
      for (int i = 0; i < 2; ++i) {
        residual[i] += speed[i] * step;
        carry[i] = speed[i] / Select(valid, slope, 1.0);
      }
    }
    CarryRows(carry, g, 3, by_point);
    CarryRows(carry, g, group.num_params, d_params);
    for (int row = 0; row < 2; ++row) {
      moved.RowByStart(by_point + 3 * row, d_point + 3 * row);
      moved.RowByTwist(by_point + 3 * row, s, d_twist + kTwistSize * row);
    }
    break;
  }
  *counts = valid;
  if (All(valid)) return;
  ZeroUncounted(valid, residual, 2);
  ZeroUncounted(valid, d_point, 6);
  ZeroUncounted(valid, d_params, 2 * group.num_params);
  ZeroUncounted(valid, d_twist, 2 * kTwistSize);
}

}  // namespace bundle::BUNDLE_ISA
