#include "core/model/coupled_blocks.h"

/// Finds the coupled blocks of a problem.
///
/// The points are processed in order and mark the pairs of their blocks in a bit table, which stays
/// in the cache. Lists of the points of each block would access the observations at random. A table
/// of all pairs may be larger than the observations, so each table covers as many columns as fit.

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <new>
#include <numeric>
#include <set>
#include <unordered_map>
#include <utility>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/problem_factors.h"
#include "core/parallel/thread_pool.h"
#include "core/sums/communicator.h"
#include "core/symbolic/block_pattern.h"
#include "core/symbolic/orderings.h"

namespace bundle {

namespace {

/// Rows of some columns, one bit each. Several threads may mark at the same time.
class ColumnBits {
 public:
  ColumnBits(int num_columns, int num_rows)
      : words_per_column_((num_rows + 63) / 64), words_(num_columns * words_per_column_) {}

  static int64_t BytesPerColumn(int num_rows) { return (int64_t{num_rows} + 63) / 64 * 8; }

  void Clear() {
    for (std::atomic<uint64_t>& word : words_) word.store(0, std::memory_order_relaxed);
  }

  void Mark(int column, int row) {
    std::atomic<uint64_t>& word = words_[column * words_per_column_ + row / 64];
    const uint64_t bit = uint64_t{1} << (row % 64);
    // Most pairs are already marked.
    if ((word.load(std::memory_order_relaxed) & bit) == 0) {
      word.fetch_or(bit, std::memory_order_relaxed);
    }
  }

  /// Appends the rows of a column, ascending.
  void Read(int column, std::vector<int>* rows) const {
    for (int64_t w = 0; w < words_per_column_; ++w) {
      const uint64_t word = words_[column * words_per_column_ + w].load(std::memory_order_relaxed);
      for (uint64_t rest = word; rest != 0; rest &= rest - 1) {
        rows->push_back(static_cast<int>(64 * w) + __builtin_ctzll(rest));
      }
    }
  }

 private:
  const int64_t words_per_column_;
  std::vector<std::atomic<uint64_t>> words_;
};

/// Blocks of the images that see a point. A block that several images share may occur several
/// times, but not consecutively.
void CollectBlocks(const ParameterLayout& layout, const int32_t* begin, const int32_t* end,
                   std::vector<int>* blocks) {
  blocks->clear();
  ParameterLayout::ImageBlocks last;
  last.fill(-1);
  for (const int32_t* image = begin; image != end; ++image) {
    const ParameterLayout::ImageBlocks& of = layout.blocks_of(*image);
    for (size_t k = 0; k < of.size(); ++k) {
      if (of[k] >= 0 && of[k] != last[k]) blocks->push_back(of[k]);
    }
    last = of;
  }
}

/// The pairs whose smaller block is one of the columns [first, last).
void MarkPairs(const std::vector<int>& blocks, int first, int last, ColumnBits* bits) {
  for (size_t k = 1; k < blocks.size(); ++k) {
    for (size_t l = 0; l < k; ++l) {
      const auto [column, row] = std::minmax(blocks[k], blocks[l]);
      if (column >= first && column < last) bits->Mark(column - first, row);
    }
  }
}

}  // namespace

std::vector<std::vector<int>> FindDirectlyCoupledBlocks(const AdjustmentProblem& problem,
                                                        const ParameterLayout& layout) {
  const auto num_blocks = static_cast<int>(layout.blocks().size());
  std::vector<std::vector<int>> columns(num_blocks);
  for (int j = 0; j < num_blocks; ++j) columns[j].push_back(j);
  const auto couple = [&](int a, int b) {
    if (a >= 0 && b >= 0) columns[std::min(a, b)].push_back(std::max(a, b));
  };
  for (int i = 0; i < problem.num_images; ++i) {
    const ParameterLayout::ImageBlocks& of = layout.blocks_of(i);
    for (size_t b = 1; b < of.size(); ++b) {
      for (size_t a = 0; a < b; ++a) couple(of[a], of[b]);
    }
  }
  for (int64_t i = 0; i < problem.num_observations && !layout.kept_points().empty(); ++i) {
    const int kept = layout.kept_block(problem.observation_point[i]);
    for (const int block : layout.blocks_of(problem.observation_image[i])) couple(block, kept);
  }
  for (const FactorUnknowns& unknowns : FindFactorUnknowns(problem, layout)) {
    const std::vector<int>& blocks = unknowns.blocks;
    for (size_t b = 1; b < blocks.size(); ++b) {
      for (size_t a = 0; a < b; ++a) columns[blocks[a]].push_back(blocks[b]);
    }
  }
  const bool is_unique = problem.factors == nullptr && problem.num_frames == 0 &&
                         problem.restrictions.camera_tie == nullptr && !layout.HasHardTwists();
  if (is_unique) return columns;
  for (std::vector<int>& rows : columns) {
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  }
  return columns;
}

namespace {

/// For each free point that factors couple with other unknowns, these unknowns: blocks of the
/// layout, and free points with a higher index.
struct Neighbours {
  std::vector<int> blocks;
  std::vector<int> points;
};

std::unordered_map<int, Neighbours> FindPointNeighbours(const AdjustmentProblem& problem,
                                                        const ParameterLayout& layout) {
  std::unordered_map<int, Neighbours> result;
  for (const FactorUnknowns& unknowns : FindFactorUnknowns(problem, layout)) {
    if (LeavesPointsApart(unknowns)) continue;
    for (const int point : unknowns.points) {
      Neighbours& neighbours = result[point];
      neighbours.blocks.insert(neighbours.blocks.end(), unknowns.blocks.begin(),
                               unknowns.blocks.end());
      for (const int other : unknowns.points) {
        if (other > point) neighbours.points.push_back(other);
      }
    }
  }
  return result;
}

void AddBlocks(const std::unordered_map<int, Neighbours>& neighbours, int point,
               std::vector<int>* blocks) {
  const auto found = neighbours.find(point);
  if (found == neighbours.end()) return;
  const std::vector<int>& more = found->second.blocks;
  blocks->insert(blocks->end(), more.begin(), more.end());
}

}  // namespace

namespace {

/// The union of the pairs of all ranks. Diagonals need not be sent, because each column has one on
/// all ranks.
void JoinColumns(Communicator* communicator, std::vector<std::vector<int>>* columns) {
  if (communicator == nullptr) return;
  const auto n = static_cast<double>(columns->size());
  std::vector<double> pairs;
  for (size_t j = 0; j < columns->size(); ++j) {
    for (size_t k = 1; k < (*columns)[j].size(); ++k) {
      pairs.push_back(static_cast<double>(j) * n + (*columns)[j][k]);
    }
  }
  for (const double pair : ConcatenateOverRanks(communicator, pairs)) {
    const double j = std::floor(pair / n);
    (*columns)[static_cast<size_t>(j)].push_back(static_cast<int>(pair - j * n));
  }
  for (std::vector<int>& rows : *columns) {
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
  }
}

}  // namespace

std::vector<std::vector<int>> FindCoupledBlocks(const AdjustmentProblem& problem,
                                                const ParameterLayout& layout, int num_threads) {
  std::vector<std::vector<int>> columns = FindDirectlyCoupledBlocks(problem, layout);
  const auto num_blocks = static_cast<int>(columns.size());
  if (num_blocks == 0) return columns;
  const Tracks tracks = GroupByPoint(problem);
  constexpr int64_t kSmallTable = int64_t{1} << 24;
  const int64_t room = std::max(kSmallTable, 4 * problem.num_observations);
  const auto width = static_cast<int>(
      std::clamp<int64_t>(room / ColumnBits::BytesPerColumn(num_blocks), 1, num_blocks));
  const auto neighbours = FindPointNeighbours(problem, layout);
  ColumnBits bits(width, num_blocks);
  for (int first = 0; first < num_blocks; first += width) {
    const int last = std::min(first + width, num_blocks);
    bits.Clear();
    for (int j = first; j < last; ++j) {
      for (const int i : columns[j]) bits.Mark(j - first, i);
      columns[j].clear();
    }
    ParallelFor(problem.num_points, num_threads, [&](int64_t begin, int64_t end) {
      std::vector<int> blocks;
      for (int64_t p = begin; p < end; ++p) {
        if (!layout.point_is_free(static_cast<int>(p))) continue;
        CollectBlocks(layout, tracks.images.data() + tracks.starts[p],
                      tracks.images.data() + tracks.starts[p + 1], &blocks);
        if (!neighbours.empty()) AddBlocks(neighbours, static_cast<int>(p), &blocks);
        MarkPairs(blocks, first, last, &bits);
      }
    });
    for (int j = first; j < last; ++j) bits.Read(j - first, &columns[j]);
  }
  JoinColumns(problem.division.communicator, &columns);
  return columns;
}

namespace {

constexpr int kPointSize = 3;

void AddPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
               BlockPattern* pattern) {
  const Tracks tracks = GroupByPoint(problem);
  const int first_block = layout.num_free_points();
  const auto neighbours = FindPointNeighbours(problem, layout);
  std::vector<int> place(neighbours.empty() ? 0
                                            : problem.num_points);  // index among the free points
  for (int point = 0, next = 0; point < static_cast<int>(place.size()); ++point) {
    place[point] = layout.point_is_free(point) ? next++ : -1;
  }
  std::vector<int> rows;
  for (int point = 0; point < problem.num_points; ++point) {
    if (!layout.point_is_free(point)) continue;
    rows.assign(1, static_cast<int>(pattern->size.size()));
    for (int64_t k = tracks.starts[point]; k < tracks.starts[point + 1]; ++k) {
      for (const int block : layout.blocks_of(tracks.images[k])) {
        if (block >= 0) rows.push_back(first_block + block);
      }
    }
    if (const auto found = neighbours.find(point); found != neighbours.end()) {
      for (const int block : found->second.blocks) rows.push_back(first_block + block);
      for (const int other : found->second.points) rows.push_back(place[other]);
    }
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    pattern->row.insert(pattern->row.end(), rows.begin(), rows.end());
    pattern->size.push_back(kPointSize);
    pattern->column_begin.push_back(static_cast<int64_t>(pattern->row.size()));
  }
}

std::vector<int> OrderByAmd(const BlockPatternView& pattern) {
  std::vector<int> order = FindOrder(pattern, OrderingMethod::kAmd);
  if (static_cast<int>(order.size()) != pattern.num_blocks) throw std::bad_alloc();
  return order;
}

}  // namespace

BlockPattern ReducedPattern(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  return MakeBlockPattern(layout.BlockSizes(), FindCoupledBlocks(problem, layout));
}

BlockPattern FullPattern(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  BlockPattern pattern;
  AddPoints(problem, layout, &pattern);
  const int first_block = layout.num_free_points();
  for (std::vector<int>& rows : FindDirectlyCoupledBlocks(problem, layout)) {
    for (const int row : rows) pattern.row.push_back(first_block + row);
    pattern.column_begin.push_back(static_cast<int64_t>(pattern.row.size()));
  }
  const std::vector<int> sizes = layout.BlockSizes();
  pattern.size.insert(pattern.size.end(), sizes.begin(), sizes.end());
  return pattern;
}

int64_t NumInformationNonzeros(const AdjustmentProblem& problem, const ParameterLayout& layout,
                               const TracksView& tracks) {
  const std::vector<int> sizes = layout.BlockSizes();
  const BlockPattern cameras = MakeBlockPattern(sizes, FindDirectlyCoupledBlocks(problem, layout));
  int64_t count = int64_t{kPointSize} * kPointSize *
                  layout.num_free_points();  // entries between blocks and points
  const auto neighbours = FindPointNeighbours(problem, layout);
  std::vector<int> last_point(sizes.size(), -1);  // last point for which a block was counted
  const auto count_block = [&](int point, int block) {
    if (block < 0 || last_point[block] == point) return;
    last_point[block] = point;
    count += 2 * kPointSize * sizes[block];
  };
  for (int p = 0; p < tracks.num_points; ++p) {
    const int point = tracks.points[p];
    if (!layout.point_is_free(point)) continue;
    for (int64_t k = tracks.starts[p]; k < tracks.starts[p + 1]; ++k) {
      for (const int block : layout.blocks_of(tracks.images[k])) count_block(point, block);
    }
    const auto found = neighbours.find(point);
    if (found == neighbours.end()) continue;
    for (const int block : found->second.blocks) count_block(point, block);
    const std::set<int> others(found->second.points.begin(), found->second.points.end());
    count += 2 * kPointSize * kPointSize * static_cast<int64_t>(others.size());
  }
  return SumOverRanks(problem.division.communicator, count) +
         static_cast<int64_t>(NumNonzeros(cameras));
}

int64_t NumInformationNonzeros(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  const Tracks tracks = GroupByPoint(problem);
  std::vector<int> points(problem.num_points);
  std::iota(points.begin(), points.end(), 0);
  return NumInformationNonzeros(
      problem, layout,
      {problem.num_points, points.data(), tracks.starts.data(), tracks.images.data()});
}

OrderedPattern OrderFullPattern(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                int64_t most_entries) {
  OrderedPattern result;
  result.pattern = FullPattern(problem, layout);
  const BlockPatternView view = result.pattern;
  if (view.num_entries() <= most_entries) {
    result.order = OrderByAmd(view);
    return result;
  }
  const int num_points = layout.num_free_points();
  result.points_first = true;
  result.order.resize(num_points);
  std::iota(result.order.begin(), result.order.end(), 0);
  for (const int block : OrderReducedPattern(problem, layout).order) {
    result.order.push_back(num_points + block);
  }
  return result;
}

OrderedPattern OrderReducedPattern(const AdjustmentProblem& problem,
                                   const ParameterLayout& layout) {
  OrderedPattern result;
  result.pattern = ReducedPattern(problem, layout);
  result.order = OrderByAmd(result.pattern);
  return result;
}

}  // namespace bundle
