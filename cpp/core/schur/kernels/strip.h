#pragma once

/// A strip: as many consecutive points as fit the first-level cache. Included by kernels.cpp only.
///
/// The passes process a chunk strip by strip. Work that is the same for every observation processes
/// kLanes observations at a time, all of one camera model. Each lane reads the records of its
/// image, point and measurement, and writes a record per observation. Work within a point then
/// reads these records in order.

#include "core/factors/reprojection.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/kernels/project_lanes.h"
#include "core/schur/kernels/rolling_lanes.h"

namespace bundle::BUNDLE_ISA {

inline constexpr int kStripPoints = 32;
inline constexpr int kStripObservations = 64;  // or more, up to the end of its last point
/// Variant for several groups: the last lanes of each group in a strip are not full.
inline constexpr int kMixedStripObservations = 128;

/// Points [first, last) of the plan with observations [begin, end).
struct Strip {
  int first, last;
  int64_t begin, end;

  Strip(const EliminationInput& input, int first_point, int last_point)
      : first(first_point), last(first_point), begin(input.plan->first.data()[first_point]) {
    const int64_t* const at = input.plan->first.data();
    const int wanted = input.num_groups > 1 ? kMixedStripObservations : kStripObservations;
    do {
      end = at[++last];
    } while (last < last_point && last - first < kStripPoints && end - begin < wanted);
  }

  int num_points() const { return last - first; }
};

/// Some observations of one group, one per lane. Lanes from `count` on repeat the last observation.
struct Lanes {
  const ModelGroup* group;
  int64_t observation[kLanes];
  int point[kLanes];
  int count;

  void Add(int64_t i, int p) {
    observation[count] = i;
    point[count] = p;
    ++count;
  }

  void Fill() {
    for (int lane = count; lane < kLanes; ++lane) {
      observation[lane] = observation[count - 1];
      point[lane] = point[count - 1];
    }
  }
};

/// Calls visit(lanes) until every observation of the strip was in a lane.
template <typename Visit>
inline void VisitLanes(const EliminationInput& input, const Strip& strip, const Visit& visit) {
  const int64_t* const first = input.plan->first.data();
  const int32_t* const image = input.plan->image.data();
  int64_t left = strip.end - strip.begin;
  for (int g = 0; left > 0; ++g) {
    Lanes lanes;
    lanes.group = input.groups + g;
    lanes.count = 0;
    for (int p = strip.first; p < strip.last; ++p) {
      for (int64_t i = first[p]; i < first[p + 1]; ++i) {
        lanes.Add(i, p);
        // Groups alternate irregularly: undoing an addition is faster than a branch.
        if (input.num_groups > 1) lanes.count -= input.image_group[image[i]] != g ? 1 : 0;
        if (lanes.count < kLanes) continue;
        visit(lanes);
        left -= kLanes;
        lanes.count = 0;
      }
    }
    if (lanes.count == 0) continue;
    lanes.Fill();
    visit(lanes);
    left -= lanes.count;
  }
}

/// State in the form that the lanes read.
struct LaneState {
  Pack pose[24];  ///< rotation, translation, left Jacobian and padding, as in StateRecords
  Pack params[kMaxCameraParams];
  Pack translation_jacobian[12];  ///< and padding; only if StateRecords has it
  bool has_translation_jacobian;
  Pack point[3];
  Pack rotated[3];       ///< R X
  Pack camera_point[3];  ///< R X + t

  /// Leaves out the Jacobians of the chart unless `for_derivatives`.
  LaneState(const EliminationInput& input, const StateRecords& x, const Lanes& lanes,
            bool for_derivatives)
      : has_translation_jacobian(for_derivatives && x.translation_jacobian > 0) {
    const int32_t* const image = input.plan->image.data();
    const double *records[kLanes], *points[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
      records[lane] = x.images + static_cast<int64_t>(image[lanes.observation[lane]]) * x.stride;
      points[lane] = x.points + 3 * static_cast<int64_t>(lanes.point[lane]);
    }
    GatherTriples(points, point);
    GatherRecords(records, for_derivatives ? 24 : 12, pose);
    if (has_translation_jacobian) {
      const double* more[kLanes];
      for (int lane = 0; lane < kLanes; ++lane) more[lane] = records[lane] + x.translation_jacobian;
      GatherRecords(more, 12, translation_jacobian);
    }
    for (int lane = 0; lane < kLanes; ++lane) records[lane] += StateRecords::kParams;
    GatherRecords(records, (lanes.group->num_params + 3) / 4 * 4, params);
    for (int i = 0; i < 3; ++i) {
      rotated[i] = pose[3 * i] * point[0] + pose[3 * i + 1] * point[1] + pose[3 * i + 2] * point[2];
      camera_point[i] = rotated[i] + pose[StateRecords::kTranslation + i];
    }
  }
};

/// The first of x.held that is no earlier observation.
inline const HeldResidual* FirstHeld(const StateRecords& x, int64_t observation) {
  int64_t first = 0, last = x.num_held;
  while (first < last) {
    const int64_t middle = first + (last - first) / 2;
    if (x.held[middle].observation < observation) {
      first = middle + 1;
    } else {
      last = middle;
    }
  }
  return x.held + first;
}

/// True if the observation is in x.held; `held` is then its residual.
inline bool FindHeld(const StateRecords& x, int64_t observation, HeldResidual* held) {
  const HeldResidual* const found = FirstHeld(x, observation);
  if (found == x.held + x.num_held || found->observation != observation) return false;
  *held = *found;
  return true;
}

/// Residuals of observations in lanes, divided by their sigmas, and their derivatives, both
/// corrected for the loss.
struct LaneResiduals {
  Pack r[2];
  Pack rho;
  Pack d_camera_point[2 * 3];
  Pack d_params[2 * kMaxCameraParams];
  Pack d_twist[2 * kTwistSize];  ///< only of groups that roll

  /// Forced inline: compilers would not inline it because Hold uses it too, which took 3 % of a
  /// step.
  __attribute__((always_inline)) LaneResiduals(const EliminationInput& input, const StateRecords& x,
                                               const LaneState& state, const Lanes& lanes,
                                               bool derive) {
    const double* const xy = input.plan->xy.data();
    const double* pairs[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) pairs[lane] = xy + 2 * lanes.observation[lane];
    Pack measurement[2];
    GatherPairs(pairs, measurement);
    const int model = lanes.group->model;
    Mask counts;
    if (lanes.group->rolls) {
      RollLanes(input, x, state, lanes, measurement, &counts);
    } else {
      kProjectLanes[model](AllCameraModels()[model], state.params, state.camera_point, measurement,
                           input.cheirality, r, derive ? d_camera_point : nullptr,
                           derive ? d_params : nullptr, &counts, lanes.count);
    }
    if (input.inverse_sigma != nullptr) DivideBySigmas(input, lanes, derive);
    if (!All(counts) || x.num_held > 0) Hold(input, x, lanes, counts, derive);
    const LossLanes loss = EvaluateLoss(input.loss, input.loss_scale, r[0] * r[0] + r[1] * r[1]);
    rho = loss.rho;
    if (!derive || input.loss == LossType::kTrivial) return;
    for (Pack& value : r) value *= loss.weight;
    for (Pack& value : d_camera_point) value *= loss.weight;
    for (int i = 0; i < 2 * lanes.group->num_params; ++i) d_params[i] *= loss.weight;
    if (lanes.group->rolls) ScaleTwist(loss.weight);
  }

  /// Not inlined, so that the code for global shutters does not change.
  __attribute__((noinline)) void RollLanes(const EliminationInput& input, const StateRecords& x,
                                           const LaneState& state, const Lanes& lanes,
                                           const Pack* measurement, Mask* counts) {
    const int32_t* const image = input.plan->image.data();
    // Known at run time only: a copy of this function for one of the cases could round differently.
    const bool is_candidate = x.found_row_times != nullptr;
    const double* records[kLanes];
    Pack row_time;
    for (int lane = 0; lane < kLanes; ++lane) {
      const int64_t observation = lanes.observation[lane];
      records[lane] = x.images + int64_t{image[observation]} * x.stride + x.shutter;
      row_time.v[lane] = is_candidate ? __builtin_nan("") : x.row_times[observation];
    }
    Pack shutter[kTwistSize + 2];
    GatherRecords(records, kTwistSize + 2, shutter);
    ProjectByRow(*lanes.group, state.params, shutter, x.at_observed_row, state.camera_point,
                 measurement, input.cheirality, !is_candidate, &row_time, r, d_camera_point,
                 d_params, d_twist, counts, lanes.count);
    if (!is_candidate) return;
    for (int lane = 0; lane < lanes.count; ++lane) {
      x.found_row_times[lanes.observation[lane]] = row_time.v[lane];
    }
  }

  __attribute__((noinline)) void ScaleTwist(const Pack& weight) {
    for (Pack& value : d_twist) value *= weight;
  }

  /// Not inlined, so that the code for problems without sigmas does not change.
  __attribute__((noinline)) void DivideBySigmas(const EliminationInput& input, const Lanes& lanes,
                                                bool derive) {
    Pack weight;
    for (int lane = 0; lane < kLanes; ++lane) {
      weight.v[lane] = input.inverse_sigma[lanes.observation[lane]];
    }
    for (Pack& value : r) value *= weight;
    if (!derive) return;
    for (Pack& value : d_camera_point) value *= weight;
    for (int i = 0; i < 2 * lanes.group->num_params; ++i) d_params[i] *= weight;
    if (lanes.group->rolls) ScaleTwist(weight);
  }

  /// Sets residuals and derivatives to zero in lanes with a held residual (factors/reprojection.h).
  /// Their cost is not included in a pass. Not inlined, because calls are rare.
  __attribute__((noinline, cold)) void Hold(const EliminationInput& input, const StateRecords& x,
                                            const Lanes& lanes, const Mask& counts, bool derive) {
    const bool is_candidate = x.before != nullptr;
    // Observations of lanes ascend: most lanes have none between their first and their last one.
    if (All(counts)) {
      const HeldResidual* const next = FirstHeld(x, lanes.observation[0]);
      if (next == x.held + x.num_held || next->observation > lanes.observation[lanes.count - 1]) {
        return;
      }
    }
    for (int lane = 0; lane < lanes.count; ++lane) {
      const int64_t observation = lanes.observation[lane];
      HeldResidual held = {observation, {0, 0}};
      const bool was_held = FindHeld(x, observation, &held);
      if (counts.bits[lane] != 0) {
        if (!was_held) continue;
        const double own = r[0].v[lane] * r[0].v[lane] + r[1].v[lane] * r[1].v[lane];
        const double* const h = held.residual;
        if (is_candidate && own <= h[0] * h[0] + h[1] * h[1]) continue;
      } else if (is_candidate && !was_held) {
        const LaneState state(input, *x.before, lanes, false);
        const LaneResiduals before(input, *x.before, state, lanes, false);
        for (int i = 0; i < 2; ++i) held.residual[i] = kHeldFactor * before.r[i].v[lane];
      }
      for (int i = 0; i < 2; ++i) r[i].v[lane] = 0;
      for (int i = 0; i < 6 && derive; ++i) d_camera_point[i].v[lane] = 0;
      for (int i = 0; i < 2 * lanes.group->num_params && derive; ++i) d_params[i].v[lane] = 0;
      for (int i = 0; i < 2 * kTwistSize && lanes.group->rolls; ++i) d_twist[i].v[lane] = 0;
      if (x.sink.add != nullptr) x.sink.add(x.sink.list, held);
    }
  }

  /// Row of the derivative with respect to the world point: a^T R.
  void ChainPoint(const LaneState& state, int row, Pack* d_point) const {
    const Pack* a = d_camera_point + 3 * row;
    for (int j = 0; j < 3; ++j) {
      d_point[j] = a[0] * state.pose[j] + a[1] * state.pose[3 + j] + a[2] * state.pose[6 + j];
    }
  }

  /// Row of the derivative w.r.t. the pose's chart: (q x a)^T J_l, a^T (factors/reprojection.h), or
  /// (q x a)^T R_s J_f, a^T R_s (factors/rig_pose.h).
  void ChainPose(const LaneState& state, int row, Pack* d_pose) const {
    const Pack* a = d_camera_point + 3 * row;
    const Pack* q = state.rotated;
    const Pack* left = state.pose + StateRecords::kLeftJacobian;
    const Pack torque[3] = {q[1] * a[2] - q[2] * a[1], q[2] * a[0] - q[0] * a[2],
                            q[0] * a[1] - q[1] * a[0]};
    for (int j = 0; j < 3; ++j) {
      d_pose[j] = torque[0] * left[j] + torque[1] * left[3 + j] + torque[2] * left[6 + j];
      d_pose[3 + j] = a[j];
    }
    if (!state.has_translation_jacobian) return;
    const Pack* turn = state.translation_jacobian;
    for (int j = 0; j < 3; ++j) {
      d_pose[3 + j] = a[0] * turn[j] + a[1] * turn[3 + j] + a[2] * turn[6 + j];
    }
  }

  /// J_c d for the steps d of the lanes' images: with v = (J_l dw) x q + dt, a^T v + (dr/dtheta)
  /// dtheta.
  void Along(const EliminationInput& input, const StepRecords& step, const Lanes& lanes,
             const LaneState& state, Pack* out) const {
    const int32_t* const image = input.plan->image.data();
    const int num_params = lanes.group->num_params;
    const double* records[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
      records[lane] =
          step.images + static_cast<int64_t>(image[lanes.observation[lane]]) * step.stride;
    }
    Pack d[StepRecords::kParams + kMaxCameraParams];
    GatherRecords(records, StepRecords::kParams + (num_params + 3) / 4 * 4, d);
    const Pack *w = d, *t = d + StepRecords::kTranslation, *q = state.rotated;
    const Pack v[3] = {w[1] * q[2] - w[2] * q[1] + t[0], w[2] * q[0] - w[0] * q[2] + t[1],
                       w[0] * q[1] - w[1] * q[0] + t[2]};
    for (int row = 0; row < 2; ++row) {
      const Pack* a = d_camera_point + 3 * row;
      out[row] = a[0] * v[0] + a[1] * v[1] + a[2] * v[2];
      for (int k = 0; k < num_params; ++k) {
        out[row] += d_params[row * num_params + k] * d[StepRecords::kParams + k];
      }
    }
    if (lanes.group->rolls) AddAlongTwist(step, records, out);
  }

  __attribute__((noinline)) void AddAlongTwist(const StepRecords& step,
                                               const double* const* records, Pack* out) const {
    const double* twists[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) twists[lane] = records[lane] + step.twist;
    Pack d[kTwistSize + 2];
    GatherRecords(twists, kTwistSize + 2, d);
    for (int row = 0; row < 2; ++row) {
      for (int k = 0; k < kTwistSize; ++k) out[row] += d_twist[kTwistSize * row + k] * d[k];
    }
  }
};

/// Adds the first `count` lanes of `values` to the lanes of a sum.
inline void AddLanes(const Pack& values, int count, Pack* sum) {
  if (count == kLanes) {
    *sum += values;
    return;
  }
  for (int lane = 0; lane < count; ++lane) sum->v[lane] += values.v[lane];
}

inline double SumOfLanes(const Pack& pack) {
  double sum = 0;
  for (int lane = 0; lane < kLanes; ++lane) sum += pack.v[lane];
  return sum;
}

}  // namespace bundle::BUNDLE_ISA
