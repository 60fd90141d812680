#include "core/fused/eliminate/point_plan.h"

#include <algorithm>
#include <limits>
#include <numeric>
#include <unordered_map>

#include "core/problem/tracks.h"

namespace bundle::fused {
namespace {

// In units of work: an observation counts one, a pair half. The larger a chunk, the more often a
// block is added to before it goes to S; the more chunks, the more evenly they spread over threads.
// A small problem is cut into eight or so, a large one into as many as 64 threads could take.
constexpr int64_t kSmallestChunk = 128;
constexpr int64_t kLargestOfSmallProblem = 8192;
constexpr int64_t kLargestChunk = 65536;
constexpr int64_t kChunksOfSmallProblem = 8;
constexpr int64_t kChunksOfLargeProblem = 64;
// Where blocks hardly repeat, as in photo collections, larger buffers pay beyond any cache: 1000
// images with a million observations took 12.3 s of processor time with 4 MiB, 10.0 with 16 and
// 8.9 with 32.
constexpr int64_t kBufferBytes = 1 << 25;
constexpr int kMaxBlocks = 1 << 16;  // of a chunk: what its indices can tell apart

class Planner {
 public:
  /// Of the observations with something to refine, or else of those without.
  Planner(const ProblemView& problem, const ParameterLayout& layout, bool active)
      : problem_(problem), layout_(layout), active_(active), refined_(problem.num_images) {
    for (int i = 0; i < problem.num_images; ++i) {
      refined_[i] = layout.image_block(i) >= 0 || layout.camera_block(problem.image_camera[i]) >= 0;
    }
    RankImages();
  }

  PointPlan Plan(int block_bytes) {
    CountObservations();
    SortPoints();
    CopyObservations();
    CutIntoChunks(block_bytes);
    return std::move(plan_);
  }

 private:
  bool IsWanted(int64_t i) const {
    return active_ == (layout_.point_is_free(problem_.observation_point[i]) ||
                       refined_[problem_.observation_image[i]] != 0);
  }

  /// by_point_: the wanted observations of each point in the order of the problem, found by
  /// counting.
  void CountObservations() {
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

  /// Refined images in the order of their blocks, which S likes best, then the others.
  void RankImages() {
    const auto block = [&](int image) {
      if (refined_[image] == 0) return std::numeric_limits<int>::max();
      const int own = layout_.image_block(image);
      return own >= 0 ? own : layout_.camera_block(problem_.image_camera[image]);
    };
    std::vector<int> images(problem_.num_images);
    std::iota(images.begin(), images.end(), 0);
    std::stable_sort(images.begin(), images.end(),
                     [&](int a, int b) { return block(a) < block(b); });
    rank_.resize(images.size());
    for (size_t k = 0; k < images.size(); ++k) rank_[images[k]] = static_cast<int>(k);
  }

  int ImageRank(int64_t observation) const {
    return rank_[problem_.observation_image[observation]];
  }

  void SortPoints() {
    struct Key {
      uint64_t images;  // the first three, 21 bits each
      int point;
    };
    std::vector<Key> keys;
    keys.reserve(problem_.num_points);
    for (int p = 0; p < problem_.num_points; ++p) {
      if (begin_[p] == begin_[p + 1]) continue;
      std::stable_sort(by_point_.begin() + begin_[p], by_point_.begin() + begin_[p + 1],
                       [&](int64_t a, int64_t b) { return ImageRank(a) < ImageRank(b); });
      const bool fixed = !layout_.point_is_free(p);
      uint64_t images = fixed ? 1 : 0;
      for (int64_t k = 0; k < 3; ++k) {
        const int64_t at = std::min(begin_[p] + k, begin_[p + 1] - 1);
        images = images << 21 | (static_cast<uint64_t>(ImageRank(by_point_[at])) & 0x1fffff);
      }
      keys.push_back({images, p});
      plan_.num_free_points += fixed ? 0 : 1;
    }
    std::sort(keys.begin(), keys.end(), [this](const Key& a, const Key& b) {
      if (a.images != b.images) return a.images < b.images;
      const int order = CompareFurtherImages(a.point, b.point);
      return order != 0 ? order < 0 : a.point < b.point;
    });
    plan_.point.reserve(keys.size());
    for (const Key& key : keys) plan_.point.push_back(key.point);
  }

  /// Lexicographically, from the fourth on.
  int CompareFurtherImages(int a, int b) const {
    int64_t i = begin_[a] + 3, j = begin_[b] + 3;
    for (; i < begin_[a + 1] && j < begin_[b + 1]; ++i, ++j) {
      const int rank_i = ImageRank(by_point_[i]), rank_j = ImageRank(by_point_[j]);
      if (rank_i != rank_j) return rank_i < rank_j ? -1 : 1;
    }
    return (i < begin_[a + 1] ? 1 : 0) - (j < begin_[b + 1] ? 1 : 0);
  }

  void CopyObservations() {
    plan_.first.reserve(plan_.point.size() + 1);
    plan_.image.reserve(by_point_.size());
    plan_.xy.reserve(2 * by_point_.size());
    for (const int p : plan_.point) {
      plan_.first.push_back(plan_.num_observations());
      for (int64_t k = begin_[p]; k < begin_[p + 1]; ++k) {
        const int64_t i = by_point_[k];
        plan_.image.push_back(problem_.observation_image[i]);
        plan_.xy.push_back(problem_.observation_xy[2 * i]);
        plan_.xy.push_back(problem_.observation_xy[2 * i + 1]);
      }
    }
    plan_.first.push_back(plan_.num_observations());
    std::vector<int64_t>().swap(by_point_);
    num_refined_.resize(plan_.point.size());
    for (int p = 0; p < plan_.num_free_points; ++p) {
      for (int64_t k = plan_.first[p]; k < plan_.first[p + 1]; ++k) {
        num_refined_[p] += refined_[plan_.image[k]];
      }
    }
  }

  void CutIntoChunks(int block_bytes) {
    const int64_t wanted = ChunkSize();
    const int64_t most_blocks = kBufferBytes / block_bytes;
    plan_.image_in_chunk.resize(plan_.num_observations());
    image_slot_.assign(problem_.num_images, -1);
    last_chunk_.assign(problem_.num_images, -1);
    for (int begin = 0; begin < plan_.num_points();) {
      begin = HasTooManyBlocks(begin) ? AddRows(begin, most_blocks)
                                      : AddChunk(begin, wanted, most_blocks);
    }
  }

  int64_t ChunkSize() const {
    int64_t work = 0;
    for (int p = 0; p < plan_.num_points(); ++p) work += WorkOf(p);
    return std::max(std::clamp(plan_.num_observations() / kChunksOfSmallProblem, kSmallestChunk,
                               kLargestOfSmallProblem),
                    std::min(work / kChunksOfLargeProblem, kLargestChunk));
  }

  int64_t NumObservations(int point) const { return plan_.first[point + 1] - plan_.first[point]; }

  int64_t WorkOf(int point) const {
    const int64_t refined = num_refined_[point];
    return NumObservations(point) + refined * (refined - 1) / 4;
  }

  bool HasTooManyBlocks(int point) const {
    const int64_t refined = num_refined_[point];
    return NumObservations(point) + refined * (refined - 1) / 2 >= kMaxBlocks / 2;
  }

  Chunk StartChunk(int point) {
    pair_of_.clear();
    Chunk chunk;
    chunk.first_point = point;
    chunk.first_pair = static_cast<int64_t>(plan_.pair_block.size());
    return chunk;
  }

  /// Adds a chunk of points from `begin` on and returns where it ended: at enough work, or
  /// where its blocks fill the buffer.
  int AddChunk(int begin, int64_t wanted, int64_t most_blocks) {
    Chunk chunk = StartChunk(begin);
    int64_t work = 0;
    int p = begin;
    for (; p < plan_.num_points(); work += WorkOf(p++)) {
      const bool full = chunk.num_blocks() > most_blocks && work >= 4 * kSmallestChunk;
      if (work >= wanted || full || chunk.num_blocks() > kMaxBlocks / 2 || HasTooManyBlocks(p)) {
        break;
      }
      AddPoint(p, 0, num_refined_[p], &chunk);
    }
    Finish(p, &chunk);
    return p;
  }

  /// One point in several chunks.
  int AddRows(int point, int64_t most_blocks) {
    const int refined = num_refined_[point];
    const auto rows = static_cast<int>(std::max<int64_t>(1, most_blocks / refined));
    for (int row = 0; row < refined; row += rows) {
      Chunk chunk = StartChunk(point);
      chunk.first_row = row;
      chunk.last_row = std::min(row + rows, refined);
      AddPoint(point, chunk.first_row, chunk.last_row, &chunk);
      Finish(point + 1, &chunk);
    }
    return point + 1;
  }

  /// Images by the slot of their first appearance for now, pairs by a number that Finish replaces.
  void AddPoint(int point, int first_row, int last_row, Chunk* chunk) {
    const int64_t first = plan_.first[point];
    for (int64_t k = first; k < plan_.first[point + 1]; ++k) {
      int& slot = image_slot_[plan_.image[k]];
      if (slot < 0) {
        slot = static_cast<int>(chunk->images.size());
        chunk->images.push_back(plan_.image[k]);
      }
      plan_.image_in_chunk[k] = static_cast<uint16_t>(slot);
    }
    const int refined = num_refined_[point];
    for (int i = first_row; i < last_row; ++i) {
      const uint16_t a = plan_.image_in_chunk[first + i];
      for (int j = i + 1; j < refined; ++j) {
        const uint16_t b = plan_.image_in_chunk[first + j];
        if (a == b) {
          plan_.pair_block.push_back(kDiagonal);
          continue;
        }
        const auto [at, is_new] =
            pair_of_.try_emplace(static_cast<uint32_t>(a) << 16 | b, chunk->pairs.size());
        if (is_new) chunk->pairs.push_back({a, b});
        plan_.pair_block.push_back(static_cast<uint16_t>(at->second));
      }
    }
  }

  /// Sorts images and pairs, so that a chunk is added to S forwards.
  void Finish(int last_point, Chunk* chunk) {
    chunk->last_point = last_point;
    const std::vector<int> before = chunk->images;
    const auto precedes = [&](int a, int b) { return rank_[a] < rank_[b]; };
    std::sort(chunk->images.begin(), chunk->images.end(), precedes);
    std::vector<uint16_t> rank(before.size());
    for (size_t s = 0; s < before.size(); ++s) {
      const auto at =
          std::lower_bound(chunk->images.begin(), chunk->images.end(), before[s], precedes);
      rank[s] = static_cast<uint16_t>(at - chunk->images.begin());
      image_slot_[before[s]] = -1;
    }
    for (int64_t k = plan_.first[chunk->first_point]; k < plan_.first[last_point]; ++k) {
      plan_.image_in_chunk[k] = rank[plan_.image_in_chunk[k]];
    }
    std::vector<uint16_t> order(chunk->pairs.size());
    std::iota(order.begin(), order.end(), uint16_t{0});
    for (Chunk::Pair& pair : chunk->pairs) pair = {rank[pair.first], rank[pair.second]};
    std::sort(order.begin(), order.end(), [&](uint16_t x, uint16_t y) {
      const Chunk::Pair &a = chunk->pairs[x], &b = chunk->pairs[y];
      return a.first != b.first ? a.first < b.first : a.second < b.second;
    });
    std::vector<Chunk::Pair> pairs(order.size());
    std::vector<uint16_t> block(order.size());
    for (size_t s = 0; s < order.size(); ++s) {
      pairs[s] = chunk->pairs[order[s]];
      block[order[s]] = static_cast<uint16_t>(chunk->images.size() + s);
    }
    chunk->pairs = std::move(pairs);
    NumberPairs(*chunk, block);
    for (const int image : chunk->images) {
      chunk->previous_chunk.push_back(last_chunk_[image]);
      last_chunk_[image] = static_cast<int>(plan_.chunks.size());
    }
    plan_.chunks.push_back(std::move(*chunk));
  }

  void NumberPairs(const Chunk& chunk, const std::vector<uint16_t>& block) {
    int64_t next = chunk.first_pair;
    for (int p = chunk.first_point; p < chunk.last_point; ++p) {
      const int refined = num_refined_[p];
      const int last_row = chunk.last_row > 0 ? chunk.last_row : refined;
      for (int i = chunk.first_row; i < last_row; ++i) {
        for (int j = i + 1; j < refined; ++j, ++next) {
          uint16_t& number = plan_.pair_block[next];
          number = number == kDiagonal ? plan_.image_in_chunk[plan_.first[p] + i] : block[number];
        }
      }
    }
  }

  static constexpr uint16_t kDiagonal = 0xffff;  ///< an image that sees a point twice

  const ProblemView& problem_;
  const ParameterLayout& layout_;
  const bool active_;
  std::vector<uint8_t> refined_;  ///< of each image
  std::vector<int> rank_;         ///< of each image
  std::vector<int64_t> begin_;
  std::vector<int64_t> by_point_;
  std::vector<int> num_refined_;  ///< of each point's observations; 0 for fixed points
  std::vector<int> image_slot_;   ///< in the chunk in the making; -1: not in it
  std::vector<int> last_chunk_;   ///< in which an image occurred; -1: none
  std::unordered_map<uint32_t, size_t> pair_of_;
  PointPlan plan_;
};

}  // namespace

int64_t LongestTrack(const ProblemView& problem) {
  const std::vector<int64_t> lengths = TrackLengths(problem);
  return lengths.empty() ? 0 : *std::max_element(lengths.begin(), lengths.end());
}

PointPlan PlanPoints(const ProblemView& problem, const ParameterLayout& layout, int block_bytes) {
  return Planner(problem, layout, true).Plan(block_bytes);
}

PointPlan PlanFixedPoints(const ProblemView& problem, const ParameterLayout& layout) {
  return Planner(problem, layout, false).Plan(1);
}

}  // namespace bundle::fused
