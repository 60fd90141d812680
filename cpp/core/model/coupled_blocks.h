#pragma once

/// Coupled blocks of a problem: the patterns of S and of the information matrix.

#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/parameter_layout.h"
#include "core/symbolic/block_pattern.h"

namespace bundle {

/// The block pairs of the reduced camera system that a residual or a free point couples: columns[j]
/// holds the blocks i >= j that are coupled with block j, ascending, j first.
std::vector<std::vector<int>> FindCoupledBlocks(const AdjustmentProblem& problem,
                                                const ParameterLayout& layout, int num_threads = 1);

/// Block pairs that a residual couples, whatever its point: a shared camera or sensor, and the
/// poses of its images.
std::vector<std::vector<int>> FindDirectlyCoupledBlocks(const AdjustmentProblem& problem,
                                                        const ParameterLayout& layout);

/// Pattern of the reduced camera system S, with one block per block of the layout
/// (FindCoupledBlocks).
BlockPattern ReducedPattern(const AdjustmentProblem& problem, const ParameterLayout& layout);

/// The information matrix J^T J of the whole problem: the free points in the order of the problem,
/// 3 x 3 each, then the blocks of the layout.
BlockPattern FullPattern(const AdjustmentProblem& problem, const ParameterLayout& layout);

/// Observations grouped by point, not owned: those of points[p] are in images[starts[p]] to
/// images[starts[p + 1] - 1].
struct TracksView {
  int num_points = 0;
  const int* points = nullptr;
  const int64_t* starts = nullptr;
  const int32_t* images = nullptr;
};

/// NumNonzeros of the full pattern, computed without building it. `tracks`: at least the free
/// points that images see or factors depend on, with all their observations.
int64_t NumInformationNonzeros(const AdjustmentProblem& problem, const ParameterLayout& layout,
                               const TracksView& tracks);

/// The same, from the problem alone.
int64_t NumInformationNonzeros(const AdjustmentProblem& problem, const ParameterLayout& layout);

/// Maximum number of entries of a full pattern on which AMD takes only seconds.
inline constexpr int64_t kMostEntriesForAmd = 2'000'000;

struct OrderedPattern {
  BlockPattern pattern;
  std::vector<int> order;
  bool points_first = false;
};

/// The full pattern and AMD's order of all its blocks, as used by a sparse Cholesky factorisation
/// of the complete problem. If the pattern has more than `most_entries`, the points come first,
/// then the blocks of S by AMD; this factor is at most a few per cent larger. Throws
/// std::bad_alloc.
OrderedPattern OrderFullPattern(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                int64_t most_entries = kMostEntriesForAmd);

/// S and AMD's order of its blocks. Throws std::bad_alloc.
OrderedPattern OrderReducedPattern(const AdjustmentProblem& problem, const ParameterLayout& layout);

}  // namespace bundle
