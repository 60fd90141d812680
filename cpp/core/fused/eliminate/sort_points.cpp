/// Points are dealt out by the first image that sees them, and each image's are then sorted and
/// their observations copied by themselves, while they are in the cache.

#include "core/fused/eliminate/sort_points.h"

#include <algorithm>
#include <limits>
#include <numeric>

#include "core/parallel_for.h"

namespace bundle::fused {
namespace {

class PointSorter {
 public:
  PointSorter(const ProblemView& problem, const ParameterLayout& layout, const ImageOrder& images,
              bool active, int num_threads)
      : problem_(problem),
        layout_(layout),
        images_(images),
        active_(active),
        num_threads_(num_threads) {}

  PointPlan Sort() {
    GroupObservations();
    SortObservations();
    DealOutPoints();
    ParallelFor(static_cast<int64_t>(plan_.point.size()), num_threads_,
                [this](int64_t begin, int64_t end) { FinishBuckets(begin, end); });
    return std::move(plan_);
  }

 private:
  bool IsWanted(int64_t i) const {
    return active_ == (layout_.point_is_free(problem_.observation_point[i]) ||
                       images_.refined[problem_.observation_image[i]] != 0);
  }

  int RankOf(int64_t observation) const {
    return images_.rank[problem_.observation_image[observation]];
  }

  /// by_point_: the wanted observations of each point, found by counting.
  void GroupObservations() {
    begin_.assign(problem_.num_points + 1, 0);
    for (int64_t i = 0; i < problem_.num_observations; ++i) {
      if (IsWanted(i)) ++begin_[problem_.observation_point[i] + 1];
    }
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    by_point_.resize(begin_.back());
    std::vector<int64_t> next(begin_.begin(), begin_.end() - 1);
    for (int64_t i = 0; i < problem_.num_observations; ++i) {
      if (IsWanted(i)) by_point_[next[problem_.observation_point[i]]++] = i;
    }
  }

  /// By rank, those of one image in the order of the problem.
  void SortObservations() {
    bucket_.assign(problem_.num_points, -1);
    ParallelFor(problem_.num_points, num_threads_, [this](int64_t begin, int64_t end) {
      for (int64_t p = begin; p < end; ++p) {
        if (begin_[p] == begin_[p + 1]) continue;
        std::sort(by_point_.begin() + begin_[p], by_point_.begin() + begin_[p + 1],
                  [this](int64_t a, int64_t b) {
                    const int rank_a = RankOf(a), rank_b = RankOf(b);
                    return rank_a != rank_b ? rank_a < rank_b : a < b;
                  });
        const bool fixed = !layout_.point_is_free(static_cast<int>(p));
        bucket_[p] = RankOf(by_point_[begin_[p]]) + (fixed ? problem_.num_images : 0);
      }
    });
  }

  /// Into buckets by their first image, the fixed points in ones of their own behind.
  void DealOutPoints() {
    const size_t num_buckets = 2 * static_cast<size_t>(problem_.num_images);
    bucket_begin_.assign(num_buckets + 1, 0);
    first_observation_.assign(num_buckets + 1, 0);
    for (int p = 0; p < problem_.num_points; ++p) {
      if (bucket_[p] < 0) continue;
      ++bucket_begin_[bucket_[p] + 1];
      first_observation_[bucket_[p] + 1] += begin_[p + 1] - begin_[p];
    }
    std::partial_sum(bucket_begin_.begin(), bucket_begin_.end(), bucket_begin_.begin());
    std::partial_sum(first_observation_.begin(), first_observation_.end(),
                     first_observation_.begin());
    plan_.num_free_points = static_cast<int>(bucket_begin_[problem_.num_images]);
    plan_.point.resize(bucket_begin_.back());
    std::vector<int64_t> next(bucket_begin_.begin(), bucket_begin_.end() - 1);
    for (int p = 0; p < problem_.num_points; ++p) {
      if (bucket_[p] >= 0) plan_.point[next[bucket_[p]]++] = p;
    }
    std::vector<int>().swap(bucket_);
    plan_.first.resize(plan_.point.size() + 1);
    plan_.first.back() = begin_.back();
    plan_.image.resize(by_point_.size());
    plan_.xy.resize(2 * by_point_.size());
  }

  /// Those that begin in [first_point, last_point).
  void FinishBuckets(int64_t first_point, int64_t last_point) {
    const auto at = std::lower_bound(bucket_begin_.begin(), bucket_begin_.end() - 1, first_point);
    for (size_t b = at - bucket_begin_.begin();
         b + 1 < bucket_begin_.size() && bucket_begin_[b] < last_point; ++b) {
      SortBucket(b);
      CopyBucket(b);
    }
  }

  /// The second to the fifth image that see a point, as far as it has so many.
  struct Key {
    uint64_t second_and_third;
    uint64_t fourth_and_fifth;
    int point;
  };
  static constexpr int kRanksInBucketAndKey = 5;

  Key KeyOf(int point) const {
    const auto rank = [&](int k) {
      const int64_t at = begin_[point] + k;
      return at < begin_[point + 1] ? static_cast<uint64_t>(RankOf(by_point_[at])) + 1 : 0;
    };
    return {rank(1) << 32 | rank(2), rank(3) << 32 | rank(4), point};
  }

  void SortBucket(size_t bucket) {
    std::vector<Key> keys;
    keys.reserve(bucket_begin_[bucket + 1] - bucket_begin_[bucket]);
    for (int64_t k = bucket_begin_[bucket]; k < bucket_begin_[bucket + 1]; ++k) {
      keys.push_back(KeyOf(plan_.point[k]));
    }
    std::sort(keys.begin(), keys.end(), [this](const Key& a, const Key& b) {
      if (a.second_and_third != b.second_and_third) return a.second_and_third < b.second_and_third;
      if (a.fourth_and_fifth != b.fourth_and_fifth) return a.fourth_and_fifth < b.fourth_and_fifth;
      const int order = CompareFurtherImages(a.point, b.point);
      return order != 0 ? order < 0 : a.point < b.point;
    });
    int* point = plan_.point.data() + bucket_begin_[bucket];
    for (const Key& key : keys) *point++ = key.point;
  }

  int CompareFurtherImages(int a, int b) const {
    int64_t i = begin_[a] + kRanksInBucketAndKey, j = begin_[b] + kRanksInBucketAndKey;
    for (; i < begin_[a + 1] && j < begin_[b + 1]; ++i, ++j) {
      const int rank_i = RankOf(by_point_[i]), rank_j = RankOf(by_point_[j]);
      if (rank_i != rank_j) return rank_i < rank_j ? -1 : 1;
    }
    return (i < begin_[a + 1] ? 1 : 0) - (j < begin_[b + 1] ? 1 : 0);
  }

  void CopyBucket(size_t bucket) {
    int64_t to = first_observation_[bucket];
    for (int64_t k = bucket_begin_[bucket]; k < bucket_begin_[bucket + 1]; ++k) {
      const int p = plan_.point[k];
      plan_.first[k] = to;
      for (int64_t at = begin_[p]; at < begin_[p + 1]; ++at, ++to) {
        const int64_t i = by_point_[at];
        plan_.image[to] = problem_.observation_image[i];
        plan_.xy[2 * to] = problem_.observation_xy[2 * i];
        plan_.xy[2 * to + 1] = problem_.observation_xy[2 * i + 1];
      }
    }
  }

  const ProblemView& problem_;
  const ParameterLayout& layout_;
  const ImageOrder& images_;
  const bool active_;
  const int num_threads_;
  std::vector<int64_t> begin_;  ///< of each point of the problem in by_point_, and the end
  std::vector<int64_t> by_point_;
  std::vector<int> bucket_;                 ///< of each point of the problem; -1: not in the plan
  std::vector<int64_t> bucket_begin_;       ///< in plan_.point
  std::vector<int64_t> first_observation_;  ///< of each bucket in the plan
  PointPlan plan_;
};

}  // namespace

ImageOrder OrderImages(const ProblemView& problem, const ParameterLayout& layout) {
  ImageOrder order;
  std::vector<int> block(problem.num_images);
  for (int i = 0; i < problem.num_images; ++i) {
    const int own = layout.image_block(i), shared = layout.camera_block(problem.image_camera[i]);
    order.refined.push_back(own >= 0 || shared >= 0 ? 1 : 0);
    block[i] = own >= 0 ? own : shared >= 0 ? shared : std::numeric_limits<int>::max();
  }
  std::vector<int> images(problem.num_images);
  std::iota(images.begin(), images.end(), 0);
  std::stable_sort(images.begin(), images.end(), [&](int a, int b) { return block[a] < block[b]; });
  order.rank.resize(images.size());
  for (size_t k = 0; k < images.size(); ++k) order.rank[images[k]] = static_cast<int>(k);
  return order;
}

PointPlan SortPoints(const ProblemView& problem, const ParameterLayout& layout,
                     const ImageOrder& images, bool active, int num_threads) {
  return PointSorter(problem, layout, images, active, num_threads).Sort();
}

}  // namespace bundle::fused
