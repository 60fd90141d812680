#pragma once

/// Pass over the points before the solution of a covariance. It finds the points that are clearly
/// determined by their observations. It also computes sums of squares and the sums for the
/// similarities of the world (covariance/gauge_sums.h). Included by kernels.cpp only.
///
/// For a point with V = L L^T and V^-1 N_p = L^-T (L^-1 N_p), an observation with rows A and B adds
/// A^T (B V^-1 N_p) to the eliminated part of its image's N. Its row of J N is A N_i + B N_p. If
/// the complete image moves with the world, this row is zero up to rounding, and A N_i = -B N_p.
/// Then only the squares of these two parts are needed, as the scale of rounding errors.

#include "core/schur/kernels/eliminate_chunk.h"
#include "core/schur/kernels/point_block.h"
#include "core/schur/kernels/strip.h"

namespace bundle::BUNDLE_ISA {

/// A row of N: kMoves numbers.
struct MoveRow {
  Quad half[2];

  static MoveRow Load(const double* from) { return {{LoadQuad(from), LoadQuad(from + 4)}}; }
  void AddTo(double* to) const {
    StoreQuad(LoadQuad(to) + half[0], to);
    StoreQuad(LoadQuad(to + 4) + half[1], to + 4);
  }
  friend MoveRow operator*(double a, const MoveRow& x) { return {{a * x.half[0], a * x.half[1]}}; }
  friend MoveRow operator+(const MoveRow& a, const MoveRow& b) {
    return {{a.half[0] + b.half[0], a.half[1] + b.half[1]}};
  }
};

/// a[0] x[0] + a[1] x[1] + a[2] x[2]
inline MoveRow Combine(const double* a, const MoveRow* x) {
  return a[0] * x[0] + a[1] * x[1] + a[2] * x[2];
}

/// N_p: translations, rotations and the scale of a point about the centre.
inline void MovesOfPoint(const WorldMoves& moves, const double* point, MoveRow* rows) {
  const double s = moves.size, x = point[0] - moves.center[0], y = point[1] - moves.center[1],
               z = point[2] - moves.center[2];
  rows[0] = {{Quad{s, 0, 0, 0}, Quad{z, -y, x, 0}}};
  rows[1] = {{Quad{0, s, 0, -z}, Quad{0, x, y, 0}}};
  rows[2] = {{Quad{0, 0, s, y}, Quad{-x, 0, z, 0}}};
}

/// to += rows^T rows, 7 x kMoves.
inline void AddSquares(const MoveRow* rows, double* to) {
  for (int m = 0; m < 7; ++m) {
    MoveRow sum = MoveRow::Load(to + kMoves * m);
    for (int i = 0; i < 3; ++i) sum = sum + rows[i].half[m / 4][m % 4] * rows[i];
    StoreQuad(sum.half[0], to + kMoves * m);
    StoreQuad(sum.half[1], to + kMoves * m + 4);
  }
}

/// True if V, whose rows are in `sum`, is clearly regular.
inline bool IsClear(const Quad* sum) {
  const double a = sum[0][0], b = sum[1][1], c = sum[2][2];
  if (!(a > 0)) return false;
  const double l10 = sum[1][0] / a, l20 = sum[2][0] / a;
  const double d1 = b - l10 * sum[1][0];
  if (!(d1 > kClearPivot * b)) return false;
  const double e = sum[2][1] - l20 * sum[1][0];
  if (!(c - l20 * sum[2][0] - e / d1 * e > kClearPivot * c)) return false;
  const double smallest = a < b ? (a < c ? a : c) : (b < c ? b : c);
  const double largest = a > b ? (a > c ? a : c) : (b > c ? b : c);
  return smallest > kClearPivot * largest;
}

/// Adds a point and its observations to the sums for N.
inline void SurveyMoves(const EliminationInput& input, const WorldMoves& moves,
                        const TileRecords& records, int64_t begin, int64_t end, const double* point,
                        const PointBlock& block, PointSurvey* survey) {
  MoveRow n[3], whitened[3], solved[3];
  MovesOfPoint(moves, point, n);
  for (int i = 0; i < 3; ++i) {
    const double row[3] = {block.column[0][i], block.column[1][i], block.column[2][i]};
    whitened[i] = Combine(row, n);
  }
  for (int i = 0; i < 3; ++i) {
    const double column[3] = {block.column[i][0], block.column[i][1], block.column[i][2]};
    solved[i] = Combine(column, whitened);
  }
  AddSquares(whitened, survey->weighted);
  AddSquares(n, survey->own);
  for (int64_t i = begin; i < end; ++i) {
    const int32_t image = input.plan->image.data()[i];
    const double* const head = records.Of(i);
    const double* const rows = records.Rows(i);
    const int64_t at = static_cast<int64_t>(image) * input.record_columns * kMoves;
    const int width = 4 * input.groups[input.image_group[image]].num_quads;
    for (int row = 0; row < 2; ++row) {
      const double* const a = rows + row * width;
      const MoveRow by_point = Combine(head + 4 * row, n);
      if (moves.moves_along[image] != 0) {
        const MoveRow both = {
            {2 * by_point.half[0] * by_point.half[0], 2 * by_point.half[1] * by_point.half[1]}};
        both.AddTo(survey->parts);
      } else {
        MoveRow by_image = {};
        for (int k = 0; k < width; ++k) {
          by_image = by_image + a[k] * MoveRow::Load(moves.images + at + kMoves * k);
        }
        double parts[2 * kMoves] = {};
        by_image.AddTo(parts);
        by_point.AddTo(parts + kMoves);
        survey->add_row(survey->list, parts, parts + kMoves);
      }
    }
    const MoveRow along_0 = Combine(head, solved), along_1 = Combine(head + 4, solved);
    for (int k = 0; k < width; ++k) {
      (rows[k] * along_0 + rows[width + k] * along_1).AddTo(survey->eliminated + at + kMoves * k);
    }
  }
}

inline void SurveyPoints(const EliminationInput& input, const StateRecords& x, const Chunk& chunk,
                         const WorldMoves& moves, double* memory, PointSurvey* survey) {
  const int64_t* const begin = input.plan->first.data();
  const int num_free = input.plan->num_free_points;
  const int last_point = chunk.last_point < num_free ? chunk.last_point : num_free;
  if (chunk.last_row > 0) {
    if (chunk.first_row == 0 && chunk.first_point < last_point) {
      survey->add_unclear(survey->list, chunk.first_point);
    }
    return;
  }
  double ignored = 0;
  int first_point = chunk.first_point;
  for (const Tile* tile = chunk.tiles.data(); first_point < last_point; ++tile) {
    const TileRecords records(input, memory, first_point);
    const int end = tile->last_point < last_point ? tile->last_point : last_point;
    VisitPoints(input, x, first_point, end, 0, true, nullptr, records, &ignored,
                [&](int p, const PointBlock& block) {
                  if (!IsClear(block.sum)) return survey->add_unclear(survey->list, p);
                  for (int64_t i = begin[p]; i < begin[p + 1]; ++i) {
                    const double* const head = records.Of(i);
                    survey->squares += head[3] * head[3] + head[7] * head[7];
                  }
                  survey->num_observations += begin[p + 1] - begin[p];
                  double h[4];
                  StoreQuad(block.h, h);
                  survey->decrease += 0.5 * Dot3(h, h);
                  if (moves.images == nullptr) return;
                  SurveyMoves(input, moves, records, begin[p], begin[p + 1],
                              x.points + 3 * int64_t{p}, block, survey);
                });
    first_point = tile->last_point;
  }
}

}  // namespace bundle::BUNDLE_ISA
