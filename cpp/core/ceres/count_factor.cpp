#include "core/ceres/count_factor.h"

#include <cmath>
#include <cstdint>
#include <new>

#include "core/ceres/ordering.h"
#include "core/solve/block_patterns.h"
#include "core/stopwatch.h"
#include "core/symbolic/block_pattern.h"
#include "core/symbolic/factor_counts.h"

namespace bundle {
namespace {

constexpr int64_t kPointSize = 3;

bool IsSchur(ceres::LinearSolverType type) {
  return type == ceres::DENSE_SCHUR || type == ceres::SPARSE_SCHUR;
}

/// Columns that are left when the images' blocks are eliminated (ordering.cpp).
int64_t NumColumnsWithoutImages(const ParameterLayout& layout) {
  int64_t num_columns = kPointSize * layout.num_free_points();
  if (!layout.has_shared_intrinsics()) return num_columns;
  for (const CameraSideBlock& block : layout.blocks()) {
    if (block.columns[0] >= kPoseSize) num_columns += block.size;
  }
  return num_columns;
}

int64_t NumColumns(const ParameterLayout& layout, EliminationOrdering ordering, bool is_schur) {
  if (!is_schur) return kPointSize * layout.num_free_points() + layout.state_size();
  return ordering == EliminationOrdering::kPointsFirst ? layout.state_size()
                                                       : NumColumnsWithoutImages(layout);
}

void SetDense(bool is_schur, FactorSummary* result) {
  const int64_t n = *result->num_columns;
  if (is_schur) result->num_reduced_nonzeros = n * n;
  result->num_nonzeros = n * (n + 1) / 2;
  result->flops = DenseFactorFlops(static_cast<double>(n));
  result->ordering = "natural";
  result->symbolic_time_in_seconds = 0;
}

void SetSparse(const ProblemView& problem, const ParameterLayout& layout, bool is_schur,
               FactorSummary* result) {
  const Stopwatch symbolic;
  const OrderedPattern ordered =
      is_schur ? OrderReducedPattern(problem, layout) : OrderFullPattern(problem, layout);
  const FactorCounts counts = CountFactor(ordered.pattern, ordered.order);
  if (is_schur) result->num_reduced_nonzeros = std::llround(NumNonzeros(ordered.pattern));
  result->num_nonzeros = std::llround(counts.entries);
  result->flops = counts.flops;
  result->ordering = ordered.points_first ? "points first, amd" : "amd";
  result->symbolic_time_in_seconds = symbolic.seconds();
}

}  // namespace

FactorSummary CountCeresFactor(const ProblemView& problem, const ParameterLayout& layout,
                               EliminationOrdering ordering, ceres::LinearSolverType type) {
  FactorSummary result;
  const bool is_schur = IsSchur(type);
  const bool is_dense = type == ceres::DENSE_SCHUR || type == ceres::DENSE_NORMAL_CHOLESKY;
  if (!is_schur && !is_dense && type != ceres::SPARSE_NORMAL_CHOLESKY) return result;
  // Ceres says how many blocks it eliminated where the choice was its own, not which.
  const bool is_known =
      ordering != EliminationOrdering::kAutomatic && !NothingToEliminate(ordering, layout);
  if (is_schur && !is_known) return result;

  result.num_columns = NumColumns(layout, ordering, is_schur);
  if (is_dense) {
    SetDense(is_schur, &result);
    return result;
  }
  // All points that an image sees meet when it is eliminated: to find who meets whom, pairs of
  // points that would be, takes far longer than it is worth.
  if (is_schur && ordering == EliminationOrdering::kCamerasFirst) return result;
  try {
    SetSparse(problem, layout, is_schur, &result);
  } catch (const std::bad_alloc&) {
    // The solve is done and its result worth more than these numbers.
  }
  return result;
}

}  // namespace bundle
