#include "core/schur/cut_chunks.h"

#include <algorithm>
#include <iterator>
#include <memory>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "core/parallel/thread_pool.h"
#include "core/schur/number_chunk.h"
#include "core/schur/pair_numbers.h"
#include "core/sums/communicator.h"

namespace bundle {

namespace {

// Limits in units of work (PointSizes::Work). Larger chunks sum up a block
// longer before it is added to S; more chunks balance the load of threads better. A large problem
// is cut into enough chunks for 64 threads. A chunk whose blocks have few pairs grows, because
// adding a block to S takes as long as four pairs, but not beyond an eighth of the problem.
constexpr int64_t kSmallestChunk = 2048, kLargestChunk = 65536;
constexpr int64_t kChunksOfProblem = 64, kLeastChunks = 8;
constexpr int64_t kWorkPerBlock = 20;
constexpr int64_t kLeastOfFullChunk = 512;
// Where blocks hardly repeat, as in photo collections, buffers larger than the cache save time:
// 1000 images with a million observations took 12.3 s of processor time with 4 MiB, 8.9 s with 32
// MiB (kMaxBufferBytes).
// Limit of the 16-bit numbers in a chunk. A point that needs more than half of them is spread over
// chunks of its own; any other fits into a chunk that is less than half full.
constexpr int kMaxBlocks = 0xffff;

/// Work of the chunks of a problem, the same on all ranks.
struct ChunkSize {
  int64_t usual = 0;
  int64_t largest = 0;  ///< limit of chunks that grow
};

/// Cuts ranges of the points of a plan into chunks, one range after the other.
class ChunkCutter {
 public:
  ChunkCutter(const ImageParts& parts, const PointSizes& sizes, const ChunkSize& chunk_size,
              EliminationPlan* plan)
      : parts_(parts),
        sizes_(sizes),
        chunk_size_(chunk_size),
        most_blocks_(kMaxBufferBytes / (parts.block_size() * static_cast<int64_t>(sizeof(double)))),
        plan_(*plan),
        entries_(*plan, parts),
        part_slot_(parts.num_parts(), -1),
        image_slot_(parts.image_group().size(), -1) {}

  /// Returns the chunks of points [begin, end), of about equal sizes.
  std::vector<Chunk> Cut(int begin, int end) {
    // At least 1: points that no image sees have no work, but their chunks must not be empty.
    const int64_t work = std::max<int64_t>(1, sizes_.Work(begin, end));
    const int64_t count = (work + chunk_size_.usual - 1) / chunk_size_.usual;
    const int64_t wanted = (work + count - 1) / count;
    for (int p = begin; p < end;) p = HasTooManyBlocks(p) ? AddRows(p) : AddChunk(p, end, wanted);
    return std::exchange(chunks_, {});
  }

 private:
  bool HasTooManyBlocks(int point) const {
    return sizes_.NumObservations(point) + sizes_.num_entries(point) + sizes_.NumPairs(point) >=
           kMaxBlocks / 2;
  }

  Chunk& StartChunk(int point) {
    pair_numbers_.Clear();
    last_entries_.clear();
    last_pairs_ = 0;
    Chunk& chunk = chunks_.emplace_back();
    chunk.first_point = point;
    return chunk;
  }

  /// Adds a chunk of the points from `begin` on and returns its end. The chunk ends at `end`, when
  /// it has enough work, or when its blocks fill the buffer.
  int AddChunk(int begin, int end, int64_t wanted) {
    Chunk& chunk = StartChunk(begin);
    int64_t work = 0;
    int p = begin;
    for (; p < end; work += sizes_.Work(p++)) {
      const bool full = chunk.num_blocks() > most_blocks_ && work >= kLeastOfFullChunk;
      const bool enough = work >= std::max(wanted, std::min(kWorkPerBlock * chunk.num_blocks(),
                                                            chunk_size_.largest));
      const bool has_numbers = chunk.num_blocks() <= kMaxBlocks / 2 &&
                               chunk.images.size() <= kMaxBlocks / 2 && !HasTooManyBlocks(p);
      if (enough || full || !has_numbers) break;
      entries_.Find(p, sizes_.num_refined(p));
      AddParts(p, &chunk);
      for (int i = 0; i < sizes_.num_refined(p); ++i) AddCrossBlocks(p, i, &chunk);
      if (sizes_.HasPairs(p)) AddPairs(&chunk);
    }
    EndChunk(p, &chunk);
    return p;
  }

  /// Spreads one point over several chunks. Each has as many rows as fit the buffer and the 16-bit
  /// numbers.
  int AddRows(int point) {
    entries_.Find(point, sizes_.num_refined(point));
    const int num_rows = entries_.size();
    const int64_t most_rows = std::max<int64_t>(1, most_blocks_ / std::max(1, num_rows));
    int i = 0;
    std::vector<int> by_row(sizes_.num_refined(point));
    std::iota(by_row.begin(), by_row.end(), 0);
    std::stable_sort(by_row.begin(), by_row.end(),
                     [&](int a, int b) { return entries_.RowOf(a) < entries_.RowOf(b); });
    for (int row = 0; row < num_rows;) {
      Chunk& chunk = StartChunk(point);
      chunk.first_row = row;
      AddParts(point, &chunk);
      const auto has_room = [&] {
        const int new_blocks = num_rows - row + kMaxParts;
        return row - chunk.first_row < most_rows && chunk.num_blocks() + new_blocks <= kMaxBlocks;
      };
      do {
        for (; i < sizes_.num_refined(point) && entries_.RowOf(by_row[i]) == row; ++i) {
          AddCrossBlocks(point, by_row[i], &chunk);
        }
        if (sizes_.HasPairs(point)) AddRow(row, &chunk);
        ++row;
      } while (row < num_rows && (!sizes_.HasPairs(point) || has_room()));
      chunk.last_row = row;
      EndChunk(point + 1, &chunk);
    }
    return point + 1;
  }

  /// Parts by the slot of their first appearance, images likewise.
  void AddParts(int point, Chunk* chunk) {
    entry_slot_.resize(entries_.size());
    for (int e = 0; e < entries_.size(); ++e) {
      int& slot = part_slot_[entries_[e]];
      if (slot < 0) {
        slot = static_cast<int>(chunk->parts.size());
        chunk->parts.push_back(entries_[e]);
      }
      entry_slot_[e] = static_cast<uint16_t>(slot);
    }
    std::vector<int>& images = draft_.images;
    for (int64_t k = plan_.first[point]; k < plan_.first[point + 1]; ++k) {
      int& slot = image_slot_[plan_.image[k]];
      if (slot < 0) {
        slot = static_cast<int>(images.size());
        images.push_back(plan_.image[k]);
        Chunk::Image& image = chunk->images.emplace_back();
        for (int kind = 0; kind < plan_.num_kinds; ++kind) {
          const int part = parts_.part_of(plan_.image[k], kind);
          if (part >= 0) image.part[kind] = static_cast<uint16_t>(part_slot_[part]);
        }
      }
      plan_.image_in_chunk[k] = static_cast<uint16_t>(slot);
    }
  }

  /// The blocks of two parts of one image.
  void AddCrossBlocks(int point, int i, Chunk* chunk) {
    Chunk::Image& image = chunk->images[plan_.image_in_chunk[plan_.first[point] + i]];
    for (int k = 0; k < plan_.num_kinds; ++k) {
      for (int l = k + 1; l < plan_.num_kinds; ++l) {
        uint16_t& block = image.cross[CrossIndex(k, l)];
        if (block != Chunk::Image::kNone || image.part[k] == Chunk::Image::kNone ||
            image.part[l] == Chunk::Image::kNone) {
          continue;
        }
        block = NumberOf(image.part[k], image.part[l], chunk);
      }
    }
  }

  uint16_t NumberOf(uint16_t a, uint16_t b, Chunk* chunk) {
    const uint16_t number = pair_numbers_.Find(a, b, chunk->pairs.size());
    if (number == chunk->pairs.size()) chunk->pairs.push_back({a, b});
    return number;
  }

  /// Numbers the pairs of all entries. Neighbours often have the same entries.
  void AddPairs(Chunk* chunk) {
    std::vector<uint16_t>& numbers = draft_.pair_numbers;
    const size_t begin = numbers.size();
    if (entries_.list() == last_entries_) {
      numbers.resize(begin + begin - last_pairs_);
      std::copy_n(numbers.begin() + last_pairs_, begin - last_pairs_, numbers.begin() + begin);
    } else {
      for (int row = 0; row < entries_.size(); ++row) AddRow(row, chunk);
      last_entries_ = entries_.list();
    }
    last_pairs_ = begin;
  }

  /// Numbers the pairs of an entry with later entries; NumberChunk replaces the numbers.
  void AddRow(int row, Chunk* chunk) {
    std::vector<uint16_t>& numbers = draft_.pair_numbers;
    const size_t begin = numbers.size();
    numbers.resize(begin + entries_.size() - row - 1);
    uint16_t* to = numbers.data() + begin;
    for (int j = row + 1; j < entries_.size(); ++j) {
      *to++ = NumberOf(entry_slot_[row], entry_slot_[j], chunk);
    }
  }

  void EndChunk(int last_point, Chunk* chunk) {
    if (chunk->num_blocks() > kMaxBlocks) {
      throw std::logic_error("a chunk of " + std::to_string(chunk->num_blocks()) +
                             " blocks does not fit 16-bit numbers");
    }
    chunk->last_point = last_point;
    for (const int part : chunk->parts) part_slot_[part] = -1;
    for (const int image : draft_.images) image_slot_[image] = -1;
    NumberChunk(parts_, sizes_, &draft_, chunk, &plan_);
  }

  const ImageParts& parts_;
  const PointSizes& sizes_;
  const ChunkSize chunk_size_;
  const int64_t most_blocks_;  ///< limit of a chunk
  EliminationPlan& plan_;
  PointEntries entries_;
  std::vector<int> part_slot_, image_slot_;  ///< slot in the current chunk; -1: not in it
  std::vector<uint16_t> entry_slot_;         ///< slot of each entry of the point
  PairNumbers pair_numbers_;                 ///< numbers in this chunk
  ChunkDraft draft_;                         ///< draft of this chunk
  std::vector<int> last_entries_;            ///< entries of the point before, in this chunk
  size_t last_pairs_ = 0;                    ///< their begin in the pairs of the draft
  std::vector<Chunk> chunks_;
};

/// Begins of ranges of points that are cut on their own: the sections, or parts of the points.
std::vector<int> CutRanges(const EliminationPlan& plan, bool in_sections) {
  if (in_sections) return plan.section_begin;
  std::vector<int> begin;
  for (size_t s = 0; s + 1 < plan.section_begin.size(); ++s) {
    const int64_t first = plan.section_begin[s], count = plan.section_begin[s + 1] - first;
    for (int64_t k = 0; k < kLeastChunks; ++k) {
      begin.push_back(static_cast<int>(first + count * k / kLeastChunks));
    }
  }
  begin.push_back(plan.section_begin.back());
  return begin;
}

}  // namespace

void CutIntoChunks(const ImageParts& parts, const PointSizes& sizes, bool in_sections,
                   Communicator* communicator, ThreadPool* pool, EliminationPlan* plan) {
  const int64_t total = SumOverRanks(communicator, sizes.Work(0, plan->num_points()));
  ChunkSize chunk_size;
  chunk_size.usual = std::clamp(total / kChunksOfProblem, kSmallestChunk, kLargestChunk);
  chunk_size.largest = std::max(chunk_size.usual, total / kLeastChunks);
  plan->image_in_chunk.resize(plan->num_observations());
  plan->entry.resize(plan->num_observations() * plan->num_kinds, 0);
  const std::vector<int> range_begin = CutRanges(*plan, in_sections);
  const size_t num_ranges = range_begin.size() - 1;
  std::vector<std::vector<Chunk>> chunks(num_ranges);
  std::vector<std::unique_ptr<ChunkCutter>> cutters(pool == nullptr ? 1 : pool->num_threads());
  ForEach(pool, static_cast<int64_t>(num_ranges), [&](int64_t r, int thread) {
    std::unique_ptr<ChunkCutter>& cutter = cutters[thread];
    if (!cutter) cutter = std::make_unique<ChunkCutter>(parts, sizes, chunk_size, plan);
    chunks[r] = cutter->Cut(range_begin[r], range_begin[r + 1]);
  });
  for (std::vector<Chunk>& range : chunks) {
    plan->chunks.insert(plan->chunks.end(), std::make_move_iterator(range.begin()),
                        std::make_move_iterator(range.end()));
  }
}

}  // namespace bundle
