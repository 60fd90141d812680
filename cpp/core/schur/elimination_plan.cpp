#include "core/schur/elimination_plan.h"

#include <algorithm>
#include <functional>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

#include "core/parallel/thread_pool.h"
#include "core/schur/image_parts.h"
#include "core/schur/number_chunk.h"
#include "core/schur/point_entries.h"
#include "core/schur/sort_points.h"
#include "core/sums/communicator.h"

namespace bundle {

namespace {

// Limits in units of work: an observation counts one, a pair half. Larger chunks sum up a block
// longer before it is added to S; more chunks balance the load of threads better. A large problem
// is cut into enough chunks for 64 threads. A chunk whose blocks have few pairs grows, because
// adding a block to S takes as long as four pairs, but not beyond a twelfth of the problem.
constexpr int64_t kSmallestChunk = 2048, kLargestChunk = 65536;
constexpr int64_t kChunksOfProblem = 64, kLeastChunks = 12;
constexpr int64_t kWorkPerBlock = 20, kLeastOfFullChunk = 512;
// Where blocks hardly repeat, as in photo collections, buffers larger than the cache still pay:
// 1000 images with a million observations took 12.3 s of processor time with 4 MiB, 8.9 s with 32
// MiB (kMaxBufferBytes).
// Limit of the 16-bit numbers in a chunk. A point that needs more than half of them is spread over
// chunks of its own; any other fits into a chunk that is less than half full.
constexpr int kMaxBlocks = 0xffff;
constexpr size_t kMostDrafts = 512;  // they take as much memory as the pairs of their chunks

/// Cuts the points of a plan into chunks.
class Planner {
 public:
  /// `communicator`: the ranks whose plans together cover the problem.
  Planner(const ImageOrder& images, const ImageParts& parts, EliminationPlan plan,
          Communicator* communicator, int num_threads)
      : images_(images),
        parts_(parts),
        plan_(std::move(plan)),
        communicator_(communicator),
        num_threads_(num_threads) {
    plan_.num_kinds = parts.num_kinds();
  }

  EliminationPlan Plan() {
    CountEntries();
    CutIntoChunks();
    NumberChunks();
    MeasureTiles();
    LinkChunks();
    return std::move(plan_);
  }

 private:
  void CountEntries() {
    num_refined_.resize(plan_.point.size(), 0);
    num_entries_.resize(plan_.point.size());
    ParallelFor(plan_.num_points(), num_threads_, [this](int64_t begin, int64_t end) {
      PointEntries entries(plan_, parts_);
      for (auto p = static_cast<int>(begin); p < end; ++p) {
        for (int64_t k = plan_.first[p]; k < plan_.first[p + 1]; ++k) {
          num_refined_[p] += images_.refined[plan_.image[k]];
        }
        entries.Find(p, num_refined_[p]);
        num_entries_[p] = entries.size();
      }
    });
  }

  void CutIntoChunks() {
    // The same on all ranks.
    const int64_t total = SumOverRanks(communicator_, WorkOf(0, plan_.num_points()));
    const int64_t usual = std::clamp(total / kChunksOfProblem, kSmallestChunk, kLargestChunk);
    largest_chunk_ = std::max(usual, total / kLeastChunks);
    const int64_t most_blocks =
        kMaxBufferBytes / (parts_.block_size() * static_cast<int64_t>(sizeof(double)));
    plan_.image_in_chunk.resize(plan_.num_observations());
    plan_.entry.resize(plan_.num_observations() * plan_.num_kinds, 0);
    part_slot_.assign(parts_.num_parts(), -1);
    image_slot_.assign(images_.rank.size(), -1);
    for (size_t s = 0; s + 1 < plan_.section_begin.size(); ++s) {
      const int begin = plan_.section_begin[s], end = plan_.section_begin[s + 1];
      // The chunks of a section have about equal sizes.
      const int64_t work = WorkOf(begin, end), count = (work + usual - 1) / usual;
      const int64_t wanted = (work + count - 1) / std::max<int64_t>(count, 1);
      for (int p = begin; p < end;) {
        p = HasTooManyBlocks(p) ? AddRows(p, most_blocks) : AddChunk(p, end, wanted, most_blocks);
        if (plan_.chunks.size() - num_numbered_ >= kMostDrafts) NumberChunks();
      }
    }
  }

  int64_t WorkOf(int begin, int end) const {
    int64_t work = 0;
    for (int p = begin; p < end; ++p) work += WorkOf(p);
    return work;
  }

  bool HasPairs(int point) const { return plan_.has_pairs && point < plan_.num_free_points; }
  int64_t NumObservations(int point) const { return plan_.first[point + 1] - plan_.first[point]; }
  int64_t NumPairs(int point) const {
    const int64_t entries = HasPairs(point) ? num_entries_[point] : 0;
    return entries * (entries - 1) / 2;
  }
  int64_t WorkOf(int point) const { return NumObservations(point) + NumPairs(point) / 2; }
  bool HasTooManyBlocks(int point) const {
    return NumObservations(point) + num_entries_[point] + NumPairs(point) >= kMaxBlocks / 2;
  }

  Chunk& StartChunk(int point) {
    pair_numbers_.Clear();
    Chunk& chunk = plan_.chunks.emplace_back();
    drafts_.emplace_back();
    chunk.first_point = point;
    return chunk;
  }

  /// Adds a chunk of the points from `begin` on and returns its end. The chunk ends at `end`, when
  /// it has enough work, or when its blocks fill the buffer.
  int AddChunk(int begin, int end, int64_t wanted, int64_t most_blocks) {
    Chunk& chunk = StartChunk(begin);
    int64_t work = 0;
    int p = begin;
    for (; p < end; work += WorkOf(p++)) {
      const bool full = chunk.num_blocks() > most_blocks && work >= kLeastOfFullChunk;
      const bool enough =
          work >= std::max(wanted, std::min(kWorkPerBlock * chunk.num_blocks(), largest_chunk_));
      const bool has_numbers = chunk.num_blocks() <= kMaxBlocks / 2 &&
                               chunk.images.size() <= kMaxBlocks / 2 && !HasTooManyBlocks(p);
      if (enough || full || !has_numbers) break;
      entries_.Find(p, num_refined_[p]);
      AddParts(p, &chunk);
      for (int i = 0; i < num_refined_[p]; ++i) AddCrossBlocks(p, i, &chunk);
      for (int row = 0; row < entries_.size() && HasPairs(p); ++row) AddRow(row, &chunk);
    }
    EndChunk(p, &chunk);
    return p;
  }

  /// Spreads one point over several chunks. Each has as many rows as fit the buffer and the 16-bit
  /// numbers.
  int AddRows(int point, int64_t most_blocks) {
    entries_.Find(point, num_refined_[point]);
    const int num_rows = entries_.size();
    const int64_t most_rows = std::max<int64_t>(1, most_blocks / std::max(1, num_rows));
    int i = 0;
    std::vector<int> by_row(num_refined_[point]);
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
        for (; i < num_refined_[point] && entries_.RowOf(by_row[i]) == row; ++i) {
          AddCrossBlocks(point, by_row[i], &chunk);
        }
        if (HasPairs(point)) AddRow(row, &chunk);
        ++row;
      } while (row < num_rows && (!HasPairs(point) || has_room()));
      chunk.last_row = row;
      EndChunk(point + 1, &chunk);
      NumberChunk(parts_, num_refined_, &drafts_.back(), &chunk,
                  &plan_);  // the next chunk numbers the same observations
    }
    return point + 1;
  }

  /// Parts by the slot of their first appearance, images likewise.
  void AddParts(int point, Chunk* chunk) {
    for (int e = 0; e < entries_.size(); ++e) {
      int& slot = part_slot_[entries_[e]];
      if (slot >= 0) continue;
      slot = static_cast<int>(chunk->parts.size());
      chunk->parts.push_back(entries_[e]);
    }
    std::vector<int>& images = drafts_.back().images;
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

  /// Numbers the pairs of an entry with later entries; NumberChunk replaces the numbers.
  void AddRow(int row, Chunk* chunk) {
    std::vector<uint16_t>& numbers = drafts_.back().pair_numbers;
    const auto a = static_cast<uint16_t>(part_slot_[entries_[row]]);
    for (int j = row + 1; j < entries_.size(); ++j) {
      numbers.push_back(NumberOf(a, static_cast<uint16_t>(part_slot_[entries_[j]]), chunk));
    }
  }

  void EndChunk(int last_point, Chunk* chunk) {
    if (chunk->num_blocks() > kMaxBlocks) {
      throw std::logic_error("a chunk of " + std::to_string(chunk->num_blocks()) +
                             " blocks does not fit 16-bit numbers");
    }
    chunk->last_point = last_point;
    for (const int part : chunk->parts) part_slot_[part] = -1;
    for (const int image : drafts_.back().images) image_slot_[image] = -1;
  }

  /// Numbers the chunks that have a draft. With less work, starting a thread takes longer.
  void NumberChunks() {
    constexpr int64_t kObservationsWorthAThread = 20000;
    const auto first = static_cast<int64_t>(num_numbered_);
    num_numbered_ = plan_.chunks.size();
    ParallelFor(
        static_cast<int64_t>(num_numbered_) - first,
        plan_.num_observations() < kObservationsWorthAThread ? 1 : num_threads_,
        [this, first](int64_t begin, int64_t end) {
          for (int64_t c = first + begin; c < first + end; ++c) {
            if (plan_.chunks[c].last_row == 0)
              NumberChunk(parts_, num_refined_, &drafts_[c - first], &plan_.chunks[c], &plan_);
          }
        },
        /*min_range=*/2);
    drafts_.clear();
  }

  void MeasureTiles() {
    for (const Chunk& chunk : plan_.chunks) {
      int first_point = chunk.first_point;
      for (const Tile& tile : chunk.tiles) {
        int entries = 0;
        for (int p = first_point; p < tile.last_point; ++p) entries += num_entries_[p];
        plan_.largest_tile_entries = std::max(plan_.largest_tile_entries, entries);
        plan_.largest_tile_points =
            std::max(plan_.largest_tile_points, tile.last_point - first_point);
        plan_.largest_tile_observations =
            std::max(plan_.largest_tile_observations,
                     plan_.first[tile.last_point] - plan_.first[first_point]);
        first_point = tile.last_point;
      }
    }
  }

  void LinkChunks() {
    std::vector<int> last_chunk(parts_.num_own_parts(), -1);
    for (size_t c = 0; c < plan_.chunks.size(); ++c) {
      Chunk& chunk = plan_.chunks[c];
      for (int i = 0; i < chunk.num_own_parts; ++i) {
        int& last = last_chunk[chunk.parts[i]];
        chunk.previous_chunk.push_back(last);
        last = static_cast<int>(c);
      }
    }
  }

  const ImageOrder& images_;
  const ImageParts& parts_;
  EliminationPlan plan_;
  Communicator* const communicator_;
  const int num_threads_;
  LargeVector<int> num_refined_;  ///< observations per point with something to refine
  LargeVector<int> num_entries_;  ///< entries per point
  size_t num_numbered_ = 0;
  std::vector<ChunkDraft> drafts_;  ///< per chunk from num_numbered_ on
  PointEntries entries_{plan_, parts_};
  std::vector<int> part_slot_, image_slot_;  ///< slot in the current chunk; -1: not in it
  int64_t largest_chunk_ = 0;                ///< limit of chunks that grow
  PairNumbers pair_numbers_;                 ///< numbers of this chunk
};

EliminationPlan Plan(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const ImageParts& parts, bool active, int num_threads, bool keep_order,
                     bool in_sections, bool has_pairs) {
  const ImageOrder images = OrderImages(problem, layout);
  EliminationPlan sorted =
      SortPoints(problem, layout, images, active, in_sections, num_threads, keep_order);
  sorted.has_pairs = has_pairs;
  // Some ranks may have no points without free parameters.
  Communicator* const communicator = active ? problem.division.communicator : nullptr;
  return Planner(images, parts, std::move(sorted), communicator, num_threads).Plan();
}

}  // namespace

EliminationPlan PlanPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const ImageParts& parts, int num_threads, bool keep_order,
                           bool in_sections, bool has_pairs) {
  return Plan(problem, layout, parts, true, num_threads, keep_order, in_sections, has_pairs);
}

EliminationPlan PlanFixedPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                const ImageParts& parts, int num_threads, bool keep_order) {
  return Plan(problem, layout, parts, false, num_threads, keep_order, /*in_sections=*/false,
              /*has_pairs=*/true);
}

PlanSize MeasurePlan(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  const ImageParts parts(problem, layout);
  const EliminationPlan plan = PlanPoints(problem, layout, parts);
  PlanSize size;
  size.num_points = plan.num_points();
  size.num_free_points = plan.num_free_points;
  size.num_observations = plan.num_observations();
  size.num_kinds = plan.num_kinds;
  for (const Chunk& chunk : plan.chunks) {
    size.num_pairs += static_cast<int64_t>(chunk.entry_pairs.size());
    size.num_tile_blocks += static_cast<int64_t>(chunk.tile_blocks.size());
    size.num_chunk_pairs += static_cast<int64_t>(chunk.pairs.size());
    size.num_chunk_parts += static_cast<int64_t>(chunk.parts.size());
    size.largest_chunk_blocks = std::max<int64_t>(size.largest_chunk_blocks, chunk.num_blocks());
  }
  size.block_doubles = parts.block_size();
  return size;
}

}  // namespace bundle
