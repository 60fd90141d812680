#include "core/schur/elimination_plan.h"

#include <algorithm>
#include <functional>
#include <numeric>
#include <stdexcept>
#include <string>
#include <utility>

#include "core/parallel/thread_pool.h"
#include "core/schur/image_parts.h"
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
// 1000 images with a million observations took 12.3 s of processor time with 4 MiB, 10.0 s with 16
// MiB and 8.9 s with 32 MiB (kMaxBufferBytes).
// Limit of the 16-bit numbers in a chunk. A point that needs more than half of them is spread over
// chunks of its own. Any other point fits into a chunk that is less than half full.
constexpr int kMaxBlocks = 0xffff;
// The factors of so many observations, 24 to 36 doubles each, fit half of a cache of 1 MiB.
constexpr int64_t kTileObservations = 2048;
constexpr int kTilePoints = 4096;  // points may have no observations

/// The entries of one point: its distinct parts, ascending, and those of its observations.
class PointEntries {
 public:
  PointEntries(const EliminationPlan& plan, const ImageParts& parts) : plan_(plan), parts_(parts) {}

  void Find(int point, int num_refined) {
    first_ = plan_.first[point];
    num_refined_ = num_refined;
    list_.clear();
    for (int kind = 0; kind < plan_.num_kinds; ++kind) {
      for (int i = 0; i < num_refined; ++i) {
        const int part = PartOf(i, kind);
        if (part >= 0 && (list_.empty() || list_.back() != part)) list_.push_back(part);
      }
    }
    const auto falls = std::adjacent_find(list_.begin(), list_.end(), std::greater_equal<>());
    if (falls == list_.end()) return;
    std::sort(list_.begin(), list_.end());
    list_.erase(std::unique(list_.begin(), list_.end()), list_.end());
  }

  int size() const { return static_cast<int>(list_.size()); }
  int num_refined() const { return num_refined_; }
  int operator[](int entry) const { return list_[entry]; }
  int PartOf(int i, int kind) const { return parts_.part_of(plan_.image[first_ + i], kind); }

  /// Entry of observation i by one of its kinds, -1: it has no such part.
  int EntryOf(int i, int kind) const {
    const int part = PartOf(i, kind);
    if (part < 0) return -1;
    return static_cast<int>(std::lower_bound(list_.begin(), list_.end(), part) - list_.begin());
  }

  /// The entry in whose row an observation's own products are added.
  int RowOf(int i) const {
    int entry = -1;
    for (int kind = 0; kind < plan_.num_kinds && entry < 0; ++kind) entry = EntryOf(i, kind);
    return entry;
  }

  /// Sets to 1 where the product of an entry with itself is among the pairs. It is not for an own
  /// part that occurs once, which the diagonal includes (kernels/eliminate_point.h).
  void FindSquares(std::vector<uint8_t>* has_square) const {
    has_square->assign(list_.size(), 1);
    for (int i = 0; i < num_refined_; ++i) {
      const int part = PartOf(i, kOwnPart);
      if (part < 0) continue;
      const bool again = (i > 0 && PartOf(i - 1, kOwnPart) == part) ||
                         (i + 1 < num_refined_ && PartOf(i + 1, kOwnPart) == part);
      if (!again) (*has_square)[EntryOf(i, kOwnPart)] = 0;
    }
  }

 private:
  const EliminationPlan& plan_;
  const ImageParts& parts_;
  int64_t first_ = 0;
  int num_refined_ = 0;
  std::vector<int> list_;
};

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
    LinkChunks();
    return std::move(plan_);
  }

 private:
  /// A chunk until its parts are sorted: the number of the block of each pair of entries, in the
  /// order of their points, and the images whose parts have numbers.
  struct Draft {
    std::vector<uint16_t> pair_numbers;
    std::vector<int> images;
  };

  void CountEntries() {
    num_refined_.resize(plan_.point.size());
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
    plan_.entry.resize(plan_.num_observations() * plan_.num_kinds);
    part_slot_.assign(parts_.num_parts(), -1);
    image_slot_.assign(images_.rank.size(), -1);
    for (size_t s = 0; s + 1 < plan_.section_begin.size(); ++s) {
      const int begin = plan_.section_begin[s], end = plan_.section_begin[s + 1];
      // The chunks of a section have about equal sizes.
      const int64_t work = WorkOf(begin, end), count = (work + usual - 1) / usual;
      const int64_t wanted = (work + count - 1) / std::max<int64_t>(count, 1);
      for (int p = begin; p < end;) {
        p = HasTooManyBlocks(p) ? AddRows(p, most_blocks) : AddChunk(p, end, wanted, most_blocks);
      }
    }
  }

  int64_t WorkOf(int begin, int end) const {
    int64_t work = 0;
    for (int p = begin; p < end; ++p) work += WorkOf(p);
    return work;
  }

  bool IsFree(int point) const { return point < plan_.num_free_points; }
  int64_t NumObservations(int point) const { return plan_.first[point + 1] - plan_.first[point]; }
  int64_t NumPairs(int point) const {
    const int64_t entries = IsFree(point) ? num_entries_[point] : 0;
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
      for (int row = 0; row < entries_.size() && IsFree(p); ++row) AddRow(row, &chunk);
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
        if (IsFree(point)) AddRow(row, &chunk);
        ++row;
      } while (row < num_rows && (!IsFree(point) || has_room()));
      chunk.last_row = row;
      EndChunk(point + 1, &chunk);
      NumberChunk(&chunk, &drafts_.back());  // the next chunk numbers the same observations
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

  void NumberChunks() {
    // With less work, starting a thread takes longer than sorting.
    constexpr int64_t kObservationsWorthAThread = 20000;
    ParallelFor(
        static_cast<int64_t>(plan_.chunks.size()),
        plan_.num_observations() < kObservationsWorthAThread ? 1 : num_threads_,
        [this](int64_t begin, int64_t end) {
          for (int64_t c = begin; c < end; ++c) {
            if (plan_.chunks[c].last_row == 0) NumberChunk(&plan_.chunks[c], &drafts_[c]);
          }
        },
        /*min_range=*/8);
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

  /// Sorts parts and pairs, so that adding a chunk accesses S in ascending order, and lists the
  /// pairs of its tiles.
  void NumberChunk(Chunk* chunk, Draft* draft) {
    const std::vector<uint16_t> rank = SortParts(chunk);
    const std::vector<uint16_t> block = SortPairs(rank, chunk);
    for (Chunk::Image& image : chunk->images) {
      for (uint16_t& part : image.part) {
        if (part != Chunk::Image::kNone) part = rank[part];
      }
      for (uint16_t& cross : image.cross) {
        if (cross != Chunk::Image::kNone) cross = block[cross];
      }
    }
    for (uint16_t& number : draft->pair_numbers) number = block[number];
    CutIntoTiles(draft->pair_numbers, chunk);
    *draft = Draft();
  }

  /// Returns the new position of each.
  std::vector<uint16_t> SortParts(Chunk* chunk) const {
    const std::vector<int> before = chunk->parts;
    std::sort(chunk->parts.begin(), chunk->parts.end());
    std::vector<uint16_t> rank;
    rank.reserve(before.size());
    for (const int part : before) {
      const auto at = std::lower_bound(chunk->parts.begin(), chunk->parts.end(), part);
      rank.push_back(static_cast<uint16_t>(at - chunk->parts.begin()));
    }
    chunk->num_own_parts = static_cast<int>(
        std::lower_bound(chunk->parts.begin(), chunk->parts.end(), parts_.num_own_parts()) -
        chunk->parts.begin());
    return rank;
  }

  /// Returns the block of each.
  static std::vector<uint16_t> SortPairs(const std::vector<uint16_t>& rank, Chunk* chunk) {
    std::vector<uint64_t> order;  // part, part, old number
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
      block[order[s] & 0xffff] = static_cast<uint16_t>(chunk->parts.size() + s);
    }
    return block;
  }

  /// `numbers`: the block of each pair of entries, in the order of the points.
  void CutIntoTiles(const std::vector<uint16_t>& numbers, Chunk* chunk) {
    PointEntries entries(plan_, parts_);
    std::vector<uint8_t> has_square;
    std::vector<uint16_t> blocks, images, observations;
    std::vector<EntryPair> pairs;
    std::vector<int> count;
    chunk->entry_pairs.reserve(numbers.size());
    chunk->tile_observations.reserve(plan_.first[chunk->last_point] -
                                     plan_.first[chunk->first_point]);
    const uint16_t* number = numbers.data();
    for (int p = chunk->first_point; p < chunk->last_point;) {
      blocks.clear();
      pairs.clear();
      images.clear();
      observations.clear();
      int num_entries = 0;
      const int first_point = p;
      const int64_t begin = plan_.first[p];
      do {
        entries.Find(p, num_refined_[p]);
        const int last_row = chunk->last_row > 0 ? chunk->last_row : entries.size();
        for (int i = 0; i < num_refined_[p]; ++i) {
          if (chunk->last_row > 0) {
            const int row = entries.RowOf(i);
            if (row < chunk->first_row || row >= last_row) continue;
          }
          images.push_back(plan_.image_in_chunk[plan_.first[p] + i]);
          observations.push_back(static_cast<uint16_t>(plan_.first[p] + i - begin));
        }
        if (!IsFree(p)) continue;
        NumberEntries(p, num_entries, entries);
        entries.FindSquares(&has_square);
        for (int e = chunk->first_row; e < last_row; ++e) {
          const auto first = static_cast<uint16_t>(num_entries + e);
          if (has_square[e]) {
            const auto at = std::lower_bound(chunk->parts.begin(), chunk->parts.end(), entries[e]);
            blocks.push_back(static_cast<uint16_t>(at - chunk->parts.begin()));
            pairs.push_back({first, first});
          }
          for (int f = e + 1; f < entries.size(); ++f) {
            blocks.push_back(*number++);
            pairs.push_back({first, static_cast<uint16_t>(num_entries + f)});
          }
        }
        num_entries += entries.size();
      } while (++p < chunk->last_point && p - first_point < kTilePoints &&
               plan_.first[p + 1] - begin <= kTileObservations);
      SortInto(blocks, pairs, chunk->num_blocks(), &count, &chunk->tile_blocks,
               &chunk->entry_pairs);
      SortInto(images, observations, static_cast<int>(chunk->images.size()), &count,
               &chunk->tile_images, &chunk->tile_observations);
      chunk->tiles.push_back({p, static_cast<int>(chunk->tile_blocks.size()),
                              static_cast<int>(chunk->tile_images.size())});
    }
    chunk->tile_images.shrink_to_fit();
    chunk->entry_pairs.shrink_to_fit();
    chunk->tile_blocks.shrink_to_fit();
    chunk->tiles.shrink_to_fit();
  }

  /// Appends the items in the order of their keys, 0 to num_keys - 1, and the count for each key
  /// that occurs.
  template <typename Item, typename KeyCount>
  static void SortInto(const std::vector<uint16_t>& keys, const std::vector<Item>& items,
                       int num_keys, std::vector<int>* place, std::vector<KeyCount>* counts,
                       std::vector<Item>* sorted) {
    place->assign(num_keys, 0);
    for (const uint16_t key : keys) ++(*place)[key];
    auto end = static_cast<int>(sorted->size());
    for (int key = 0; key < num_keys; ++key) {
      const int count = (*place)[key];
      if (count > 0) {
        counts->push_back({static_cast<uint16_t>(key), static_cast<uint16_t>(count)});
      }
      (*place)[key] = end;
      end += count;
    }
    sorted->resize(end);
    for (size_t k = 0; k < items.size(); ++k) (*sorted)[(*place)[keys[k]]++] = items[k];
  }

  void NumberEntries(int point, int first_entry, const PointEntries& entries) {
    std::vector<uint8_t> is_seen(entries.size());
    uint16_t* to = &plan_.entry[plan_.first[point] * plan_.num_kinds];
    for (int i = 0; i < entries.num_refined(); ++i) {
      for (int kind = 0; kind < plan_.num_kinds; ++kind, ++to) {
        const int e = entries.EntryOf(i, kind);
        if (e < 0) {
          *to = EliminationPlan::kFirstOfEntry;
          continue;
        }
        *to = static_cast<uint16_t>(first_entry + e);
        if (!std::exchange(is_seen[e], 1)) *to |= EliminationPlan::kFirstOfEntry;
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
  std::vector<int> num_refined_;  ///< observations per point with something to refine
  std::vector<int> num_entries_;  ///< entries per point
  std::vector<Draft> drafts_;     ///< per chunk
  PointEntries entries_{plan_, parts_};
  std::vector<int> part_slot_, image_slot_;  ///< slot in the current chunk; -1: not in it
  int64_t largest_chunk_ = 0;                ///< limit of chunks that grow
  PairNumbers pair_numbers_;                 ///< numbers for the current chunk
};

EliminationPlan Plan(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const ImageParts& parts, bool active, int num_threads, bool keep_order,
                     bool in_sections) {
  const ImageOrder images = OrderImages(problem, layout);
  EliminationPlan sorted =
      SortPoints(problem, layout, images, active, in_sections, num_threads, keep_order);
  // Some ranks may have no points without free parameters.
  Communicator* const communicator = active ? problem.division.communicator : nullptr;
  return Planner(images, parts, std::move(sorted), communicator, num_threads).Plan();
}

}  // namespace

EliminationPlan PlanPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const ImageParts& parts, int num_threads, bool keep_order,
                           bool in_sections) {
  return Plan(problem, layout, parts, true, num_threads, keep_order, in_sections);
}

EliminationPlan PlanFixedPoints(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                const ImageParts& parts, int num_threads, bool keep_order) {
  return Plan(problem, layout, parts, false, num_threads, keep_order, /*in_sections=*/false);
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
