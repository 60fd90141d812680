#pragma once

/// Back-substitution, and the evaluation of a step. Included by kernels.cpp only.
///
/// Given the step d of the cameras, u_i = A_i d (eliminate_point.h) is a directional derivative
/// that needs no A_i, and
///
///   dX = -V'^-1 (g + sum of B_i^T u_i).
///
/// Storing V'^-1, g and B_i from the elimination would cost 64 bytes per observation. Writing and
/// reading them would take longer than computing them again, and this computation also evaluates
/// the candidate.

#include "core/schur/kernels/point_block.h"
#include "core/schur/kernels/strip.h"

namespace bundle::BUNDLE_ISA {

/// Records of a strip: [a_0 r_0 | a_1 r_1 | u_0 u_1 v_0 v_1] per observation. u = A d for one
/// direction d of the cameras, v for a second direction if there are two.
inline constexpr int kStepRecord = 12;

inline void LinearizeAlong(const EliminationInput& input, const StateRecords& x, const Strip& strip,
                           const Lanes& lanes, const StepRecords& step, const StepRecords* other,
                           double* records) {
  const LaneState state(input, x, lanes, false);  // neither chart nor its Jacobians
  const LaneResiduals residuals(input, x, state, lanes, true);
  double* out[kLanes];
  double discarded[kStepRecord];
  for (int lane = 0; lane < kLanes; ++lane) {
    const int64_t slot = lanes.observation[lane] - strip.begin;
    out[lane] = lane < lanes.count ? records + slot * kStepRecord : discarded;
  }
  Pack along[4] = {0.0, 0.0, 0.0, 0.0};
  residuals.Along(input, step, lanes, state, along);
  if (other != nullptr) residuals.Along(input, *other, lanes, state, along + 2);
  for (int row = 0; row < 2; ++row) {
    Pack d_point[3];
    residuals.ChainPoint(state, row, d_point);
    const Pack* const tail[4] = {d_point, d_point + 1, d_point + 2, residuals.r + row};
    ScatterRecords(tail, out, 4 * row);
  }
  const Pack* const last[4] = {along, along + 1, along + 2, along + 3};
  ScatterRecords(last, out, 8);
}

/// dX = -V'^-1 (g + sum of B^T u); u is stored in entries `entry` and `entry` + 1 of the point's
/// records.
inline void BackSubstitute(const PointBlock& block, const double* records, int64_t count, int entry,
                           double* step) {
  Quad sum = {block.Gradient(0), block.Gradient(1), block.Gradient(2), 0};
  for (const double* at = records; at < records + count * kStepRecord; at += kStepRecord) {
    sum += LoadQuad(at) * at[entry] + LoadQuad(at + 4) * at[entry + 1];
  }
  SolveTransposed(block, -block.Whiten(sum), step);
}

/// Adds the costs of a strip's observations to the lanes of `twice_cost`, twice.
inline void AddCosts(const EliminationInput& input, const StateRecords& x, const Lanes& lanes,
                     Pack* twice_cost) {
  const LaneState state(input, x, lanes, false);
  AddLanes(LaneResiduals(input, x, state, lanes, false).rho, lanes.count, twice_cost);
}

/// Adds m^T (r + m / 2) to the lanes of a sum, with m = A d + B dX: the change of the model's cost.
/// `steps`: dX of the strip's points.
inline void AddModel(const Strip& strip, const Lanes& lanes, const double* records,
                     const Quad* steps, Pack* sum) {
  const double* of_lanes[kLanes];
  Quad rows[kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {
    of_lanes[lane] = records + (lanes.observation[lane] - strip.begin) * kStepRecord;
    rows[lane] = steps[lanes.point[lane] - strip.first];
  }
  Pack record[kStepRecord], d[4], change = 0.0;
  GatherRecords(of_lanes, kStepRecord, record);
  PacksOfRows(rows, d);
  for (int row = 0; row < 2; ++row) {
    const Pack* const a = record + 4 * row;
    const Pack m = record[8 + row] + a[0] * d[0] + a[1] * d[1] + a[2] * d[2];
    change += m * (a[3] + 0.5 * m);
  }
  AddLanes(change, lanes.count, sum);
}

/// p^T J^T J q and p^T J^T r of the factors of a point.
inline double PriorProduct(const double* prior, const double* p, const double* q) {
  return p[0] * Dot3(prior, q) + p[1] * Dot3(prior + 4, q) + p[2] * Dot3(prior + 8, q);
}

inline double PriorGradient(const double* prior, const double* p) {
  return p[0] * prior[3] + p[1] * prior[7] + p[2] * prior[11];
}

inline void EvaluateNewtonStep(const EliminationInput& input, const StateRecords& x,
                               const Chunk& chunk, double damping, const double* squared_scale,
                               const StepRecords& step, const StateRecords& candidate,
                               double* candidate_points, double* memory, CandidateSum* sum) {
  const int64_t* const begin = input.plan->first.data();
  PointBlock blocks[kStripPoints];
  Quad steps[kStripPoints];
  Pack twice_cost = 0.0, model = 0.0;
  Quad step_squared = {}, state_squared = {};
  for (int point = chunk.first_point; point < chunk.last_point && chunk.first_row == 0;) {
    const Strip strip(input, point, chunk.last_point);
    VisitLanes(input, strip, [&](const Lanes& lanes) {
      LinearizeAlong(input, x, strip, lanes, step, nullptr, memory);
    });
    FormPointBlocks(input, strip, memory, kStepRecord, damping, false, squared_scale, blocks);
    for (int p = strip.first; p < strip.last; ++p) {
      const bool is_free = p < input.plan->num_free_points;
      double d[4] = {};
      if (is_free) {
        BackSubstitute(blocks[p - strip.first], memory + (begin[p] - strip.begin) * kStepRecord,
                       begin[p + 1] - begin[p], 8, d);
      }
      const Quad by = LoadQuad(d), moved = LoadTriple(x.points + 3 * p) + by;
      steps[p - strip.first] = by;
      for (int j = 0; j < 3; ++j) candidate_points[3 * p + j] = moved[j];
      step_squared += by * by;
      if (is_free) state_squared += moved * moved;
      if (const double* const prior = input.PriorOf(p)) {
        sum->model_cost_change -= PriorGradient(prior, d) + 0.5 * PriorProduct(prior, d, d);
      }
    }
    VisitLanes(input, strip, [&](const Lanes& lanes) {
      AddModel(strip, lanes, memory, steps, &model);
      AddCosts(input, candidate, lanes, &twice_cost);
    });
    point = strip.last;
  }
  sum->model_cost_change -= SumOfLanes(model);
  sum->cost += 0.5 * SumOfLanes(twice_cost);
  sum->step_squared += step_squared[0] + step_squared[1] + step_squared[2];
  sum->state_squared += state_squared[0] + state_squared[1] + state_squared[2];
}

inline void AddProducts(const double* record, const double* p, const double* q, ProductSum* sum) {
  for (int row = 0; row < 2; ++row) {
    const double* const a = record + 4 * row;
    const double along_p = record[8 + row] + Dot3(a, p), along_q = record[10 + row] + Dot3(a, q);
    sum->j_pp += along_p * along_p;
    sum->j_pq += along_p * along_q;
    sum->j_qq += along_q * along_q;
  }
}

inline void Products(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                     double damping, const double* squared_scale, const StepRecords& camera_p,
                     const StepRecords& camera_q, double* points_p, double* points_q,
                     double* points_d_squared, double* memory, ProductSum* sum) {
  const int64_t* const begin = input.plan->first.data();
  PointBlock blocks[kStripPoints];
  for (int point = chunk.first_point; point < chunk.last_point && chunk.first_row == 0;) {
    const Strip strip(input, point, chunk.last_point);
    VisitLanes(input, strip, [&](const Lanes& lanes) {
      LinearizeAlong(input, x, strip, lanes, camera_p, &camera_q, memory);
    });
    FormPointBlocks(input, strip, memory, kStepRecord, damping, false, squared_scale, blocks);
    for (int i = strip.first; i < strip.last; ++i) {
      const int64_t count = begin[i + 1] - begin[i];
      const double* const records = memory + (begin[i] - strip.begin) * kStepRecord;
      const PointBlock& block = blocks[i - strip.first];
      double *p = points_p + 3 * i, *q = points_q + 3 * i;
      for (int j = 0; j < 3; ++j) p[j] = q[j] = 0;
      if (i < input.plan->num_free_points) {
        BackSubstitute(block, records, count, 10, q);
        for (int j = 0; j < 3; ++j) {
          const double d_squared = block.d_squared[j];
          p[j] = block.Gradient(j) / d_squared;
          sum->d_pp += p[j] * d_squared * p[j];
          sum->d_pq += p[j] * d_squared * q[j];
          sum->d_qq += q[j] * d_squared * q[j];
          if (points_d_squared != nullptr) points_d_squared[3 * i + j] = d_squared;
        }
      }
      for (int64_t k = 0; k < count; ++k) AddProducts(records + k * kStepRecord, p, q, sum);
      if (const double* const prior = input.PriorOf(i)) {
        sum->j_pp += PriorProduct(prior, p, p);
        sum->j_pq += PriorProduct(prior, p, q);
        sum->j_qq += PriorProduct(prior, q, q);
      }
    }
    point = strip.last;
  }
}

inline double Cost(const EliminationInput& input, const StateRecords& x, const Chunk& chunk) {
  Pack twice_cost = 0.0;
  for (int point = chunk.first_point; point < chunk.last_point && chunk.first_row == 0;) {
    const Strip strip(input, point, chunk.last_point);
    VisitLanes(input, strip, [&](const Lanes& lanes) { AddCosts(input, x, lanes, &twice_cost); });
    point = strip.last;
  }
  return 0.5 * SumOfLanes(twice_cost);
}

/// d^T J^T r at x, for a step of the cameras and a step of the points (3 numbers each).
inline double Slope(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                    const StepRecords& step, const double* points_step, double* memory) {
  const int64_t* const begin = input.plan->first.data();
  double slope = 0;
  for (int point = chunk.first_point; point < chunk.last_point && chunk.first_row == 0;) {
    const Strip strip(input, point, chunk.last_point);
    VisitLanes(input, strip, [&](const Lanes& lanes) {
      LinearizeAlong(input, x, strip, lanes, step, nullptr, memory);
    });
    const double* record = memory;
    for (int p = strip.first; p < strip.last; ++p) {
      for (int64_t i = begin[p]; i < begin[p + 1]; ++i, record += kStepRecord) {
        for (int row = 0; row < 2; ++row) {
          const double along = record[8 + row] + Dot3(record + 4 * row, points_step + 3 * p);
          slope += along * record[4 * row + 3];
        }
      }
    }
    point = strip.last;
  }
  return slope;
}

}  // namespace bundle::BUNDLE_ISA
