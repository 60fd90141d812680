#include "core/schur/elimination_plan.h"

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>

#include "core/parallel/thread_pool.h"
#include "core/schur/sort_points.h"
#include "core/schur/state_records.h"
#include "core/sums/communicator.h"

namespace bundle {

namespace {

// Limits in units of work: an observation counts one, a pair half. Larger chunks sum up a block
// longer before it is added to S; more chunks balance the load of threads better. A small problem
// is cut into about eight chunks. A large one is cut into enough chunks for 64 threads.
constexpr int64_t kSmallestChunk = 128;
constexpr int64_t kLargestOfSmallProblem = 8192;
constexpr int64_t kLargestChunk = 65536;
constexpr int64_t kChunksOfSmallProblem = 8;
constexpr int64_t kChunksOfLargeProblem = 64;
// Where blocks hardly repeat, as in photo collections, buffers larger than the cache still pay:
// 1000 images with a million observations took 12.3 s of processor time with 4 MiB, 10.0 s with 16
// MiB and 8.9 s with 32 MiB (kMaxBufferBytes).
// Limit of the 16-bit numbers in a chunk; kDiagonal is reserved. A point that needs more than half
// of them is spread over chunks of its own. Any other point fits into a chunk that is less than
// half full.
constexpr int kMaxBlocks = 0xffff;

/// Cuts the points of a plan into chunks.
class Planner {
 public:
  /// `ranks`: the ranks whose plans together cover the problem.
  Planner(ImageOrder images, EliminationPlan plan, Communicator* communicator, int num_threads)
      : images_(std::move(images)),
        plan_(std::move(plan)),
        communicator_(communicator),
        num_threads_(num_threads) {}

  EliminationPlan Plan(int block_bytes) {
    CountRefinedObservations();
    CutIntoChunks(block_bytes);
    SortChunks();
    LinkChunks();
    return std::move(plan_);
  }

 private:
  void CountRefinedObservations() {
    num_refined_.resize(plan_.point.size());
    ParallelFor(plan_.num_free_points, num_threads_, [this](int64_t begin, int64_t end) {
      for (int64_t p = begin; p < end; ++p) {
        for (int64_t k = plan_.first[p]; k < plan_.first[p + 1]; ++k) {
          num_refined_[p] += images_.refined[plan_.image[k]];
        }
      }
    });
  }

  void CutIntoChunks(int block_bytes) {
    const int64_t largest = ChunkSize();
    const int64_t most_blocks = kMaxBufferBytes / block_bytes;
    plan_.image_in_chunk.resize(plan_.num_observations());
    plan_.pair_block.reserve(CountPairs());
    image_slot_.assign(images_.rank.size(), -1);
    for (size_t s = 0; s + 1 < plan_.section_begin.size(); ++s) {
      const int begin = plan_.section_begin[s], end = plan_.section_begin[s + 1];
      // The chunks of a section have about equal sizes.
      const int64_t work = WorkOf(begin, end), count = (work + largest - 1) / largest;
      const int64_t wanted = (work + count - 1) / std::max<int64_t>(count, 1);
      for (int p = begin; p < end;) {
        p = HasTooManyBlocks(p) ? AddRows(p, most_blocks) : AddChunk(p, end, wanted, most_blocks);
      }
    }
  }

  int64_t CountPairs() const {
    int64_t pairs = 0;
    for (const int64_t refined : num_refined_) pairs += refined * (refined - 1) / 2;
    return pairs;
  }

  /// Size of a chunk, the same on all ranks.
  int64_t ChunkSize() const {
    const int64_t work = SumOverRanks(communicator_, WorkOf(0, plan_.num_points()));
    const int64_t observations = SumOverRanks(communicator_, plan_.num_observations());
    return std::max(
        std::clamp(observations / kChunksOfSmallProblem, kSmallestChunk, kLargestOfSmallProblem),
        std::min(work / kChunksOfLargeProblem, kLargestChunk));
  }

  int64_t WorkOf(int begin, int end) const {
    int64_t work = 0;
    for (int p = begin; p < end; ++p) work += WorkOf(p);
    return work;
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
    pair_numbers_.Clear();
    Chunk chunk;
    chunk.first_point = point;
    chunk.first_pair = static_cast<int64_t>(plan_.pair_block.size());
    return chunk;
  }

  /// Adds a chunk of the points from `begin` on and returns its end. The chunk ends at `end`, when
  /// it has enough work, or when its blocks fill the buffer.
  int AddChunk(int begin, int end, int64_t wanted, int64_t most_blocks) {
    Chunk chunk = StartChunk(begin);
    int64_t work = 0;
    int p = begin;
    for (; p < end; work += WorkOf(p++)) {
      const bool full = chunk.num_blocks() > most_blocks && work >= 4 * kSmallestChunk;
      if (work >= wanted || full || chunk.num_blocks() > kMaxBlocks / 2 || HasTooManyBlocks(p)) {
        break;
      }
      AddImages(p, &chunk);
      for (int row = 0; row < num_refined_[p]; ++row) AddRow(p, row, &chunk);
    }
    EndChunk(p, &chunk);
    return p;
  }

  /// Spreads one point over several chunks. Each has as many rows as fit the buffer and the 16-bit
  /// numbers.
  int AddRows(int point, int64_t most_blocks) {
    const int refined = num_refined_[point];
    const int64_t most_rows = std::max<int64_t>(1, most_blocks / refined);
    for (int row = 0; row < refined;) {
      Chunk chunk = StartChunk(point);
      chunk.first_row = row;
      AddImages(point, &chunk);
      const auto has_room = [&] {
        const auto new_pairs = std::min<int64_t>(refined - 1 - row, chunk.images.size());
        return row - chunk.first_row < most_rows && chunk.num_blocks() + new_pairs <= kMaxBlocks;
      };
      do {
        AddRow(point, row++, &chunk);
      } while (row < refined && has_room());
      chunk.last_row = row;
      EndChunk(point + 1, &chunk);
      SortChunk(&plan_.chunks.back());  // the next chunk numbers the same observations
    }
    return point + 1;
  }

  /// Images by the slot of their first appearance; SortChunk replaces these slots later.
  void AddImages(int point, Chunk* chunk) {
    for (int64_t k = plan_.first[point]; k < plan_.first[point + 1]; ++k) {
      int& slot = image_slot_[plan_.image[k]];
      if (slot < 0) {
        slot = static_cast<int>(chunk->images.size());
        chunk->images.push_back(plan_.image[k]);
      }
      plan_.image_in_chunk[k] = static_cast<uint16_t>(slot);
    }
  }

  /// Adds the pairs of refined observation `row` with later observations, by numbers that SortChunk
  /// replaces later.
  void AddRow(int point, int row, Chunk* chunk) {
    const int64_t first = plan_.first[point];
    const uint16_t a = plan_.image_in_chunk[first + row];
    for (int j = row + 1; j < num_refined_[point]; ++j) {
      const uint16_t b = plan_.image_in_chunk[first + j];
      if (a == b) {
        plan_.pair_block.push_back(kDiagonal);
        continue;
      }
      const uint16_t number = pair_numbers_.Find(a, b, chunk->pairs.size());
      if (number == chunk->pairs.size()) chunk->pairs.push_back({a, b});
      plan_.pair_block.push_back(number);
    }
  }

  void EndChunk(int last_point, Chunk* chunk) {
    if (chunk->num_blocks() > kMaxBlocks) {
      throw std::logic_error("a chunk of " + std::to_string(chunk->num_blocks()) +
                             " blocks does not fit 16-bit numbers");
    }
    chunk->last_point = last_point;
    for (const int image : chunk->images) image_slot_[image] = -1;
    plan_.chunks.push_back(std::move(*chunk));
  }

  void SortChunks() {
    // With less work, starting a thread takes longer than sorting.
    constexpr int64_t kObservationsWorthAThread = 20000;
    ParallelFor(
        static_cast<int64_t>(plan_.chunks.size()),
        plan_.num_observations() < kObservationsWorthAThread ? 1 : num_threads_,
        [this](int64_t begin, int64_t end) {
          for (int64_t c = begin; c < end; ++c) {
            if (plan_.chunks[c].last_row == 0) SortChunk(&plan_.chunks[c]);
          }
        },
        /*min_range=*/8);
  }

  /// Sorts images and pairs, so that adding a chunk accesses S in ascending order.
  void SortChunk(Chunk* chunk) {
    const std::vector<uint16_t> rank = SortImages(chunk);
    for (int64_t k = plan_.first[chunk->first_point]; k < plan_.first[chunk->last_point]; ++k) {
      plan_.image_in_chunk[k] = rank[plan_.image_in_chunk[k]];
    }
    std::vector<uint64_t> order;  // image, image, old number
    order.reserve(chunk->pairs.size());
    for (const Chunk::Pair& pair : chunk->pairs) {
      const uint64_t first = rank[pair.first], second = rank[pair.second];
      order.push_back(first << 32 | second << 16 | order.size());
    }
    std::sort(order.begin(), order.end());
    std::vector<uint16_t> block(order.size());
    for (size_t s = 0; s < order.size(); ++s) {
      chunk->pairs[s] = {static_cast<uint16_t>(order[s] >> 32),
                         static_cast<uint16_t>(order[s] >> 16)};
      block[order[s] & 0xffff] = static_cast<uint16_t>(chunk->images.size() + s);
    }
    NumberPairs(*chunk, block);
  }

  /// Returns the new position of each.
  std::vector<uint16_t> SortImages(Chunk* chunk) const {
    const std::vector<int> before = chunk->images;
    const auto precedes = [&](int a, int b) { return images_.rank[a] < images_.rank[b]; };
    std::sort(chunk->images.begin(), chunk->images.end(), precedes);
    std::vector<uint16_t> rank;
    rank.reserve(before.size());
    for (const int image : before) {
      const auto at = std::lower_bound(chunk->images.begin(), chunk->images.end(), image, precedes);
      rank.push_back(static_cast<uint16_t>(at - chunk->images.begin()));
    }
    return rank;
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

  void LinkChunks() {
    std::vector<int> last_chunk(images_.rank.size(), -1);
    for (size_t c = 0; c < plan_.chunks.size(); ++c) {
      Chunk& chunk = plan_.chunks[c];
      for (const int image : chunk.images) {
        chunk.previous_chunk.push_back(last_chunk[images_.owner[image]]);
      }
      for (const int image : chunk.images) last_chunk[images_.owner[image]] = static_cast<int>(c);
    }
    plan_.image_owner = images_.owner;
  }

  static constexpr uint16_t kDiagonal =
      0xffff;  ///< pair of an image with itself, where it sees a point twice

  const ImageOrder images_;
  EliminationPlan plan_;
  Communicator* const communicator_;
  const int num_threads_;
  std::vector<int>
      num_refined_;  ///< observations per point with something to refine; 0 for fixed points
  std::vector<int> image_slot_;  ///< slot in the current chunk; -1: not in it
  PairNumbers pair_numbers_;     ///< numbers for the current chunk
};

EliminationPlan Plan(const AdjustmentProblem& problem, const ParameterLayout& layout, bool active,
                     int block_bytes, int num_threads, bool keep_order, bool in_sections) {
  ImageOrder images = OrderImages(problem, layout);
  EliminationPlan sorted =
      SortPoints(problem, layout, images, active, in_sections, num_threads, keep_order);
  // Some ranks may have no points without free parameters.
  Communicator* const communicator = active ? problem.division.communicator : nullptr;
  return Planner(std::move(images), std::move(sorted), communicator, num_threads).Plan(block_bytes);
}

}  // namespace

EliminationPlan PlanPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           int block_bytes, int num_threads, bool keep_order, bool in_sections) {
  return Plan(problem, layout, true, block_bytes, num_threads, keep_order, in_sections);
}

EliminationPlan PlanFixedPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                int num_threads, bool keep_order) {
  return Plan(problem, layout, false, 1, num_threads, keep_order, /*in_sections=*/false);
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

PlanSize MeasurePlan(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  const int block_doubles = GroupImages(problem, layout).block_size();
  const EliminationPlan plan =
      PlanPoints(problem, layout, block_doubles * static_cast<int>(sizeof(double)));
  PlanSize size;
  size.num_points = plan.num_points();
  size.num_free_points = plan.num_free_points;
  size.num_observations = plan.num_observations();
  size.num_pairs = static_cast<int64_t>(plan.pair_block.size());
  for (const Chunk& chunk : plan.chunks) {
    size.num_chunk_pairs += static_cast<int64_t>(chunk.pairs.size());
    size.num_chunk_images += static_cast<int64_t>(chunk.images.size());
    size.largest_chunk_blocks = std::max<int64_t>(size.largest_chunk_blocks, chunk.num_blocks());
  }
  size.block_doubles = block_doubles;
  return size;
}

}  // namespace bundle
