#include "core/linear/coarse_space.h"

/// Schur-Jacobi hardly reduces the slowly converging errors. In these errors, clusters of images
/// move, turn or scale relative to each other while each cluster stays consistent. Or the images of
/// a cluster share a change of intrinsics that poses and points compensate. So each cluster has as
/// its directions
///
///   - the seven similarities of the world, cut to the cluster's images (model/gauge.h),
///   - for k = 0, 1, ... the k-th intrinsics column of all of its blocks at once.
///
/// The directions of all clusters, the columns of Q, span every similarity of the world, the near
/// null space of S. With them, the number of iterations of conjugate gradients does not grow with
/// the number of images (Nicolaides, Deflation of conjugate gradients, 1987; Konolige and Brown,
/// Multigrid for bundle adjustment, 2020, smooth the same space).
///
/// Each block of A is summed by one thread, in the order of S's blocks, so that its bits are the
/// same for any number of threads. The cost is 4 m^2 d flops for each block of S, with m its size
/// and d directions. The elimination takes about 2 m^2 L for each point that L images see.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>

#include "core/linear/clusters.h"
#include "core/linear/fill_ordering.h"
#include "core/linear/supernodal_cholesky.h"
#include "core/linear/supernodes.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

/// With this number of images per cluster, A has about a fifth of the columns of S, and its
/// factorisation takes about a hundredth of the flops.
constexpr int kMaxClusterSize = 6;

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// X = Q_i^T S_ij Q_j. kSize and kDirections: sizes of both blocks, or Eigen::Dynamic.
template <int kSize, int kDirections>
void ProjectBlock(const double* block, int stride, bool lower_only, const double* rows_q,
                  int row_size, int row_directions, const double* cols_q, int col_size,
                  int col_directions, Eigen::MatrixXd* x) {
  constexpr int kMax = kSize == Eigen::Dynamic ? BlockSystem::kMaxBlockSize : kSize;
  constexpr int kMaxDirections =
      kSize == Eigen::Dynamic ? kMax + CoarseSpace::kNumGaugeDirections : kDirections;
  using Block = Eigen::Matrix<double, kSize, kSize, Eigen::ColMajor, kMax, kMax>;
  using Q = Eigen::Matrix<double, kSize, kDirections, Eigen::RowMajor, kMax, kMaxDirections>;
  using Product = Eigen::Matrix<double, kSize, kDirections, Eigen::ColMajor, kMax, kMaxDirections>;
  const Eigen::Map<const Block, 0, Eigen::OuterStride<>> stored(block, row_size, col_size,
                                                                Eigen::OuterStride<>(stride));
  const Eigen::Map<const Q> q_i(rows_q, row_size, row_directions);
  const Eigen::Map<const Q> q_j(cols_q, col_size, col_directions);
  Product product(row_size, col_directions);
  if (lower_only) {
    product.noalias() = stored.template selfadjointView<Eigen::Lower>() * q_j;
  } else {
    product.noalias() = stored.lazyProduct(q_j);
  }
  x->noalias() = q_i.transpose().lazyProduct(product);
}

}  // namespace

CoarseSpace::CoarseSpace(const BlockStructure& structure, const BlockSystem& system,
                         int num_threads)
    : fine_(structure), num_threads_(num_threads), moves_(structure.num_columns(), 0) {
  for (int k = 0; k < fine_.num_columns(); ++k) {
    const double* const row =
        &system.gauge_directions[static_cast<size_t>(k) * kNumGaugeDirections];
    moves_[k] = std::any_of(row, row + kNumGaugeDirections, [](double v) { return v != 0; });
  }
  std::vector<char> alone(fine_.num_blocks(), 0);
  for (int j = 0; j < fine_.num_blocks(); ++j) alone[j] = !MovesBlock(fine_, moves_, j);
  NumberClusters(ClusterBlocks(fine_, system.values, alone, kMaxClusterSize));
  CollectTerms();
  direction_begin_.push_back(0);
  for (int j = 0; j < fine_.num_blocks(); ++j) {
    direction_begin_.push_back(direction_begin_.back() +
                               static_cast<int64_t>(fine_.block_size(j)) * num_directions(j));
  }
  directions_.resize(direction_begin_.back());
  is_idle_.resize(coarse_.num_columns());
  values_.resize(coarse_.num_values);
}

/// Numbers the clusters in the order of their elimination and lays out A.
void CoarseSpace::NumberClusters(const std::vector<int>& cluster) {
  const int count = cluster.empty() ? 0 : 1 + *std::max_element(cluster.begin(), cluster.end());
  std::vector<int> size(count, 0);
  std::vector<char> moves(count, 0);
  for (int j = 0; j < fine_.num_blocks(); ++j) {
    int still = 0;
    for (int k = fine_.offset[j]; k < fine_.offset[j + 1]; ++k) {
      still += moves_[k] == 0;
      moves[cluster[j]] |= moves_[k];
    }
    size[cluster[j]] = std::max(size[cluster[j]], still);
  }
  for (int c = 0; c < count; ++c) size[c] += moves[c] != 0 ? kNumGaugeDirections : 0;

  std::vector<std::vector<int>> columns(count);
  for (int c = 0; c < count; ++c) columns[c].push_back(c);
  for (int j = 0; j < fine_.num_blocks(); ++j) {
    for (int64_t e = fine_.column_begin[j] + 1; e < fine_.column_begin[j + 1]; ++e) {
      const int a = cluster[fine_.row_block[e]], b = cluster[j];
      if (a != b) columns[std::min(a, b)].push_back(std::max(a, b));
    }
  }
  for (std::vector<int>& rows : columns) {
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  }
  const BlockStructure unordered = SparseStructure(size, columns);
  const FillOrdering ordering = FindFillOrdering(unordered);
  const BlockStructure ordered = Reorder(unordered, ordering.order);
  Supernodes supernodes = FindSupernodes(ordered);
  coarse_ = PlaceInFactor(ordered, supernodes);
  cholesky_ = std::make_unique<SupernodalCholesky>(coarse_.offset, std::move(supernodes));

  std::vector<int> number(count);
  for (int k = 0; k < count; ++k) number[ordering.order[k]] = k;
  members_.resize(count);
  for (int j = 0; j < fine_.num_blocks(); ++j) {
    cluster_.push_back(number[cluster[j]]);
    members_[cluster_[j]].push_back(j);
  }
}

/// Sorts the blocks of S by the blocks of A to which they contribute.
void CoarseSpace::CollectTerms() {
  const auto for_each = [&](const auto& visit) {
    for (int j = 0; j < fine_.num_blocks(); ++j) {
      for (int64_t e = fine_.column_begin[j]; e < fine_.column_begin[j + 1]; ++e) {
        const int i = fine_.row_block[e];
        const int a = cluster_[i], b = cluster_[j];
        const auto first = coarse_.row_block.begin() + coarse_.column_begin[std::min(a, b)];
        const auto last = coarse_.row_block.begin() + coarse_.column_begin[std::min(a, b) + 1];
        const auto entry = std::lower_bound(first, last, std::max(a, b));
        visit(entry - coarse_.row_block.begin(),
              Term{fine_.ValueIndex(j, e, 0, 0), fine_.panel_stride[j], i, j, a < b, i == j});
      }
    }
  };
  term_begin_.assign(coarse_.row_block.size() + 1, 0);
  for_each([&](int64_t entry, const Term&) { ++term_begin_[entry + 1]; });
  for (size_t k = 1; k < term_begin_.size(); ++k) term_begin_[k] += term_begin_[k - 1];
  input_.resize(term_begin_.back());
  std::vector<int64_t> next(term_begin_.begin(), term_begin_.end() - 1);
  for_each([&](int64_t entry, const Term& term) { input_[next[entry]++] = term; });

  coarse_column_.resize(coarse_.row_block.size());
  for (int b = 0; b < coarse_.num_blocks(); ++b) {
    std::fill(coarse_column_.begin() + coarse_.column_begin[b],
              coarse_column_.begin() + coarse_.column_begin[b + 1], b);
  }
}

bool CoarseSpace::Factorize(const BlockSystem& system) {
  constexpr int64_t kRanges = 64;
  ParallelFor(
      coarse_.num_blocks(), num_threads_,
      [&](int64_t begin, int64_t end) {
        for (int64_t c = begin; c < end; ++c) MakeDirections(system, static_cast<int>(c));
      },
      /*min_range=*/50);
  std::fill(values_.begin(), values_.end(), 0.0);
  const auto num_terms = static_cast<int64_t>(input_.size());
  const auto first_entry = [&](int64_t range) {
    return std::lower_bound(term_begin_.begin(), term_begin_.end() - 1,
                            num_terms * range / kRanges) -
           term_begin_.begin();
  };
  ParallelFor(
      kRanges, num_terms < 1000 ? 1 : num_threads_,
      [&](int64_t begin, int64_t end) {
        for (int64_t e = first_entry(begin); e < first_entry(end); ++e) {
          ProjectEntry(system.values, coarse_column_[e], e);
        }
      },
      /*min_range=*/1);
  return cholesky_->Factorize(values_.data()) == 0;
}

void CoarseSpace::Solve(double* x) { cholesky_->Solve(values_.data(), x); }

void CoarseSpace::MakeDirections(const BlockSystem& system, int cluster) {
  const int num_columns = coarse_.block_size(cluster);
  const ClusterDirections directions =
      FindClusterDirections(fine_, system, moves_, members_[cluster], num_columns);
  std::copy(directions.is_idle.begin(), directions.is_idle.end(),
            is_idle_.begin() + coarse_.offset[cluster]);
  int row = 0;
  for (const int j : members_[cluster]) {
    const int size = fine_.block_size(j);
    Eigen::Map<RowMajor>(&directions_[direction_begin_[j]], size, num_columns) =
        directions.q.middleRows(row, size);
    row += size;
  }
}

void CoarseSpace::ProjectEntry(const BlockValues& values, int column, int64_t entry) {
  Eigen::Map<Eigen::MatrixXd, 0, Eigen::OuterStride<>> sum(
      &values_[coarse_.ValueIndex(column, entry, 0, 0)],
      coarse_.block_size(coarse_.row_block[entry]), coarse_.block_size(column),
      Eigen::OuterStride<>(coarse_.panel_stride[column]));
  Eigen::MatrixXd x;
  const bool on_diagonal = coarse_.row_block[entry] == column;
  for (int64_t t = term_begin_[entry]; t < term_begin_[entry + 1]; ++t) {
    const Term& term = input_[t];
    const int row_size = fine_.block_size(term.row_block);
    const int col_size = fine_.block_size(term.col_block);
    const int row_directions = num_directions(term.row_block);
    const int col_directions = num_directions(term.col_block);
    const bool square = row_size == col_size && row_directions == col_directions;
    auto* project = &ProjectBlock<Eigen::Dynamic, Eigen::Dynamic>;
    if (square && row_size == 9 && row_directions == 10) project = &ProjectBlock<9, 10>;
    if (square && row_size == 8 && row_directions == 9) project = &ProjectBlock<8, 9>;
    if (square && row_size == 6 && row_directions == 7) project = &ProjectBlock<6, 7>;
    project(&values[term.value], term.stride, term.diagonal,
            &directions_[direction_begin_[term.row_block]], row_size, row_directions,
            &directions_[direction_begin_[term.col_block]], col_size, col_directions, &x);
    if (!term.transposed) sum += x;
    if (term.transposed || (on_diagonal && !term.diagonal)) sum += x.transpose();
  }
  if (!on_diagonal) return;
  for (int m = 0; m < coarse_.block_size(column); ++m) {
    if (is_idle_[coarse_.offset[column] + m] != 0) sum(m, m) = 1;
  }
}

void CoarseSpace::Restrict(const double* from, double* to) const {
  std::fill(to, to + coarse_.num_columns(), 0.0);
  for (int j = 0; j < fine_.num_blocks(); ++j) {
    const int count = num_directions(j);
    const double* q = &directions_[direction_begin_[j]];
    double* const target = to + coarse_.offset[cluster_[j]];
    for (int k = fine_.offset[j]; k < fine_.offset[j + 1]; ++k, q += count) {
      for (int m = 0; m < count; ++m) target[m] += q[m] * from[k];
    }
  }
}

void CoarseSpace::AddProlonged(const double* from, double* to) const {
  for (int j = 0; j < fine_.num_blocks(); ++j) {
    const int count = num_directions(j);
    const double* q = &directions_[direction_begin_[j]];
    const double* const source = from + coarse_.offset[cluster_[j]];
    for (int k = fine_.offset[j]; k < fine_.offset[j + 1]; ++k, q += count) {
      for (int m = 0; m < count; ++m) to[k] += q[m] * source[m];
    }
  }
}

}  // namespace bundle
