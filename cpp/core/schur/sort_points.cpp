#include "core/schur/sort_points.h"

/// Problems often list their observations point by point, as BAL does, but the order in which
/// points are sorted reads memory at random. Each point is therefore read once for its key and once
/// for its final place, both times in the order of the problem. In between, the keys are
/// distributed over buckets and sorted within these. The bucket of a point is its section if
/// sections are used (point_sections.h), or else the first image that sees the point.
///
/// During sorting, an observation is one number: the rank of its image in the upper bits, its own
/// index in the lower bits. Comparing two of them then needs no lookup.

#include <algorithm>
#include <cstdint>
#include <limits>
#include <numeric>
#include <string>

#include "core/error.h"
#include "core/linear/block_structure.h"
#include "core/parallel/thread_pool.h"
#include "core/schur/elimination_plan.h"
#include "core/scratch/large_vector.h"
#include "core/sums/point_sections.h"

namespace bundle {
namespace {

class PointSorter {
 public:
  PointSorter(const AdjustmentProblem& problem, const ParameterLayout& layout,
              const ImageOrder& images, bool active, bool in_sections, ThreadPool* pool,
              bool keep_order)
      : problem_(problem),
        layout_(layout),
        images_(images),
        active_(active),
        pool_(pool),
        keep_order_(keep_order) {
    num_buckets_ = problem.num_images;
    if (!in_sections) return;
    if (problem.division.point_section == nullptr) {
      sections_ =
          FindPointSections(problem.num_images, problem.num_points, problem.num_observations,
                            problem.observation_image, problem.observation_point, pool);
    }
    section_ = problem.division.point_section == nullptr ? sections_.data()
                                                         : problem.division.point_section;
    num_buckets_ = 0;
    for (int p = 0; p < problem.num_points; ++p) {
      num_buckets_ = std::max(num_buckets_, section_[p] + 1);
    }
  }

  EliminationPlan Sort() {
    GroupObservations();
    SortObservations();
    DealOutPoints();
    ParallelFor(static_cast<int64_t>(keys_.size()), pool_,
                [this](int64_t begin, int64_t end) { PlacePoints(begin, end); });
    LargeVector<Key>().swap(keys_);
    MakeRoom();
    ParallelFor(problem_.num_points, pool_,
                [this](int64_t begin, int64_t end) { CopyObservations(begin, end); });
    return std::move(plan_);
  }

 private:
  bool IsWanted(int64_t i) const {
    return active_ == (layout_.point_is_free(problem_.observation_point[i]) ||
                       images_.refined[problem_.observation_image[i]] != 0);
  }

  static constexpr int kIndexBits = 32;
  static constexpr uint64_t kIndex = (uint64_t{1} << kIndexBits) - 1;

  uint64_t Ranked(int64_t observation) const {
    const auto rank = static_cast<uint64_t>(images_.rank[problem_.observation_image[observation]]);
    return rank << kIndexBits | static_cast<uint64_t>(observation);
  }
  static int RankOf(uint64_t ranked) { return static_cast<int>(ranked >> kIndexBits); }
  static int64_t IndexOf(uint64_t ranked) { return static_cast<int64_t>(ranked & kIndex); }

  /// by_point_: the selected observations of each point, by a counting sort.
  void GroupObservations() {
    if (problem_.num_observations > static_cast<int64_t>(kIndex)) {
      throw InputError("observation_xy: expected at most " + std::to_string(kIndex) + ", found " +
                       std::to_string(problem_.num_observations));
    }
    begin_.assign(problem_.num_points + 1, 0);
    for (int64_t i = 0; i < problem_.num_observations; ++i) {
      if (IsWanted(i)) ++begin_[problem_.observation_point[i] + 1];
    }
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    by_point_.resize(begin_.back());
    LargeVector<int64_t> next(begin_.begin(), begin_.end() - 1);
    for (int64_t i = 0; i < problem_.num_observations; ++i) {
      if (IsWanted(i)) by_point_[next[problem_.observation_point[i]]++] = Ranked(i);
    }
  }

  /// Sorts by rank; observations of one image keep the order of the problem.
  void SortObservations() {
    keys_.resize(problem_.num_points);
    ParallelFor(problem_.num_points, pool_, [this](int64_t begin, int64_t end) {
      for (int64_t p = begin; p < end; ++p) {
        std::sort(by_point_.begin() + begin_[p], by_point_.begin() + begin_[p + 1]);
        keys_[p] = KeyOf(static_cast<int>(p));
      }
    });
  }

  /// Sorting key of a point: its bucket (that of its section or its first image) and its first
  /// images.
  struct Key {
    uint64_t first_and_second;
    uint64_t third_and_fourth;
    int bucket;  ///< -1: not in the plan
    int point;
  };

  static constexpr int kRanksInKey = 4;

  Key KeyOf(int point) const {
    const auto rank = [&](int k) {
      const int64_t at = begin_[point] + k;
      return at < begin_[point + 1] ? static_cast<uint64_t>(RankOf(by_point_[at])) + 1 : 0;
    };
    const bool is_seen = rank(0) > 0, is_free = layout_.point_is_free(point);
    // A point that only factors depend on comes before those that images see.
    const bool is_unseen = !is_seen && is_free && active_ && problem_.factors != nullptr;
    int bucket = -1;
    if (is_seen || is_unseen) {
      const int first = is_seen ? static_cast<int>(rank(0)) - 1 : 0;
      bucket = section_ != nullptr ? section_[point] : first;
      if (!is_free) bucket += num_buckets_;
    }
    return {rank(0) << 32 | rank(1), rank(2) << 32 | rank(3), bucket, point};
  }

  /// Distributes into buckets; those of fixed points come last.
  void DealOutPoints() {
    const size_t num_buckets = 2 * static_cast<size_t>(num_buckets_);
    bucket_begin_.assign(num_buckets + 1, 0);
    first_observation_.assign(num_buckets + 1, 0);
    for (const Key& key : keys_) {
      if (key.bucket < 0) continue;
      ++bucket_begin_[key.bucket + 1];
      first_observation_[key.bucket + 1] += begin_[key.point + 1] - begin_[key.point];
    }
    std::partial_sum(bucket_begin_.begin(), bucket_begin_.end(), bucket_begin_.begin());
    std::partial_sum(first_observation_.begin(), first_observation_.end(),
                     first_observation_.begin());
    LargeVector<Key> dealt(bucket_begin_.back());
    std::vector<int64_t> next(bucket_begin_.begin(), bucket_begin_.end() - 1);
    for (const Key& key : keys_) {
      if (key.bucket >= 0) dealt[next[key.bucket]++] = key;
    }
    keys_ = std::move(dealt);
    plan_.num_free_points = static_cast<int>(bucket_begin_[num_buckets_]);
    for (size_t b = 0; b < num_buckets; ++b) {
      const bool is_first = section_ == nullptr && b == 0;
      if (!is_first && (section_ == nullptr || bucket_begin_[b] == bucket_begin_[b + 1])) continue;
      plan_.section_begin.push_back(static_cast<int>(bucket_begin_[b]));
    }
    plan_.section_begin.push_back(static_cast<int>(keys_.size()));
    plan_.point.resize(keys_.size());
    plan_.first.resize(keys_.size() + 1);
    plan_.first.back() = begin_.back();
    place_.resize(problem_.num_points);
  }

  /// Sorts the buckets that begin in [first_point, last_point).
  void PlacePoints(int64_t first_point, int64_t last_point) {
    const auto at = std::lower_bound(bucket_begin_.begin(), bucket_begin_.end() - 1, first_point);
    for (size_t b = at - bucket_begin_.begin();
         b + 1 < bucket_begin_.size() && bucket_begin_[b] < last_point; ++b) {
      SortBucket(b);
      int64_t observation = first_observation_[b];
      for (int64_t k = bucket_begin_[b]; k < bucket_begin_[b + 1]; ++k) {
        const int p = keys_[k].point;
        plan_.point[k] = p;
        plan_.first[k] = place_[p] = observation;
        observation += begin_[p + 1] - begin_[p];
      }
    }
  }

  void SortBucket(size_t bucket) {
    std::sort(keys_.begin() + bucket_begin_[bucket], keys_.begin() + bucket_begin_[bucket + 1],
              [this](const Key& a, const Key& b) {
                if (a.first_and_second != b.first_and_second) {
                  return a.first_and_second < b.first_and_second;
                }
                if (a.third_and_fourth != b.third_and_fourth) {
                  return a.third_and_fourth < b.third_and_fourth;
                }
                const int order = CompareFurtherImages(a.point, b.point);
                return order != 0 ? order < 0 : a.point < b.point;
              });
  }

  int CompareFurtherImages(int a, int b) const {
    int64_t i = begin_[a] + kRanksInKey, j = begin_[b] + kRanksInKey;
    for (; i < begin_[a + 1] && j < begin_[b + 1]; ++i, ++j) {
      const int rank_i = RankOf(by_point_[i]), rank_j = RankOf(by_point_[j]);
      if (rank_i != rank_j) return rank_i < rank_j ? -1 : 1;
    }
    return (i < begin_[a + 1] ? 1 : 0) - (j < begin_[b + 1] ? 1 : 0);
  }

  void MakeRoom() {
    plan_.image.resize(by_point_.size());
    plan_.xy.resize(2 * by_point_.size());
    if (problem_.observation_sigma != nullptr) plan_.inverse_sigma.resize(by_point_.size());
    if (keep_order_) plan_.observation.resize(by_point_.size());
  }

  void CopyObservations(int64_t first_point, int64_t last_point) {
    for (int64_t p = first_point; p < last_point; ++p) {
      int64_t to = place_[p];
      for (int64_t at = begin_[p]; at < begin_[p + 1]; ++at, ++to) {
        const int64_t i = IndexOf(by_point_[at]);
        plan_.image[to] = problem_.observation_image[i];
        plan_.xy[2 * to] = problem_.observation_xy[2 * i];
        plan_.xy[2 * to + 1] = problem_.observation_xy[2 * i + 1];
        if (problem_.observation_sigma != nullptr) {
          plan_.inverse_sigma[to] = 1 / problem_.observation_sigma[i];
        }
        if (keep_order_) plan_.observation[to] = static_cast<int32_t>(i);
      }
    }
  }

  const AdjustmentProblem& problem_;
  const ParameterLayout& layout_;
  const ImageOrder& images_;
  const bool active_;
  ThreadPool* const pool_;
  const bool keep_order_;
  LargeVector<uint16_t> sections_;  ///< used if the problem has no sections
  const uint16_t* section_ =
      nullptr;           ///< section per point of the problem; nullptr: sections are not used
  int num_buckets_ = 0;  ///< numbers of buckets of free points, and of fixed points
  LargeVector<int64_t> begin_;  ///< per point of the problem: its begin in by_point_; then the end
  LargeVector<uint64_t> by_point_;
  LargeVector<Key> keys_;  ///< keys of the points of the problem, then of those in the plan
  std::vector<int64_t> bucket_begin_;       ///< in keys_, then in plan_.point
  std::vector<int64_t> first_observation_;  ///< per bucket in the plan
  LargeVector<int64_t> place_;              ///< per point: place of its observations in the plan
  EliminationPlan plan_;
};

}  // namespace

ImageOrder OrderImages(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  ImageOrder order;
  std::vector<int> block(problem.num_images);
  for (int i = 0; i < problem.num_images; ++i) {
    const ParameterLayout::ImageBlocks& blocks = layout.blocks_of(i);
    const auto first = std::find_if(blocks.begin(), blocks.end(), [](int b) { return b >= 0; });
    order.refined.push_back(first != blocks.end() ? 1 : 0);
    block[i] = first != blocks.end() ? *first : std::numeric_limits<int>::max();
  }
  std::vector<int> images(problem.num_images);
  std::iota(images.begin(), images.end(), 0);
  std::stable_sort(images.begin(), images.end(), [&](int a, int b) { return block[a] < block[b]; });
  order.rank.resize(images.size());
  for (size_t k = 0; k < images.size(); ++k) order.rank[images[k]] = static_cast<int>(k);
  return order;
}

EliminationPlan SortPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const ImageOrder& images, bool active, bool in_sections,
                           ThreadPool* pool, bool keep_order) {
  return PointSorter(problem, layout, images, active, in_sections, pool, keep_order).Sort();
}

void TakeMeasurements(const AdjustmentProblem& problem, EliminationPlan* plan) {
  for (size_t k = 0; k < plan->observation.size(); ++k) {
    std::copy_n(problem.observation_xy + 2 * int64_t{plan->observation[k]}, 2, &plan->xy[2 * k]);
  }
  const bool has_sigmas = problem.observation_sigma != nullptr;
  plan->inverse_sigma.resize(has_sigmas ? plan->observation.size() : 0);
  for (size_t k = 0; k < plan->inverse_sigma.size(); ++k) {
    plan->inverse_sigma[k] = 1 / problem.observation_sigma[plan->observation[k]];
  }
}

}  // namespace bundle
