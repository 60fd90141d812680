#include "core/schur/number_chunk.h"

#include <algorithm>
#include <utility>

#include "core/schur/point_entries.h"

namespace bundle {
namespace {

// More observations add more pairs to a block while it is in registers: a step on 177 images with
// 31 observations a point takes 93 ms with 2048, 84 ms with 4096, 83 ms with 8192. Where tracks are
// short, all sizes from 256 on are as fast.
constexpr int64_t kTileObservations = 4096;
constexpr int kTilePoints = 4096;  // points may have no observations

class ChunkNumbering {
 public:
  ChunkNumbering(const ImageParts& parts, const PointSizes& sizes, Chunk* chunk,
                 EliminationPlan* plan)
      : parts_(parts), sizes_(sizes), chunk_(*chunk), plan_(*plan) {}

  void Number(ChunkDraft* draft) {
    const std::vector<uint16_t> rank = SortParts();
    const std::vector<uint16_t> block = SortPairs(rank);
    for (Chunk::Image& image : chunk_.images) {
      for (uint16_t& part : image.part) {
        if (part != Chunk::Image::kNone) part = rank[part];
      }
      for (uint16_t& cross : image.cross) {
        if (cross != Chunk::Image::kNone) cross = block[cross];
      }
    }
    for (uint16_t& number : draft->pair_numbers) number = block[number];
    CutIntoTiles(draft->pair_numbers);
    draft->pair_numbers.clear();
    draft->images.clear();
  }

 private:
  /// Returns the new position of each.
  std::vector<uint16_t> SortParts() {
    const std::vector<int> before = chunk_.parts;
    std::sort(chunk_.parts.begin(), chunk_.parts.end());
    std::vector<uint16_t> rank;
    rank.reserve(before.size());
    for (const int part : before) {
      const auto at = std::lower_bound(chunk_.parts.begin(), chunk_.parts.end(), part);
      rank.push_back(static_cast<uint16_t>(at - chunk_.parts.begin()));
    }
    chunk_.num_own_parts = static_cast<int>(
        std::lower_bound(chunk_.parts.begin(), chunk_.parts.end(), parts_.num_own_parts()) -
        chunk_.parts.begin());
    return rank;
  }

  /// Returns the block of each.
  std::vector<uint16_t> SortPairs(const std::vector<uint16_t>& rank) {
    std::vector<uint64_t> order;  // part, part, old number
    order.reserve(chunk_.pairs.size());
    for (const Chunk::Pair& pair : chunk_.pairs) {
      const uint64_t first = rank[pair.first], second = rank[pair.second];
      order.push_back(first << 32 | second << 16 | order.size());
    }
    std::sort(order.begin(), order.end());
    std::vector<uint16_t> block(order.size());
    for (size_t s = 0; s < order.size(); ++s) {
      chunk_.pairs[s] = {static_cast<uint16_t>(order[s] >> 32),
                         static_cast<uint16_t>(order[s] >> 16)};
      block[order[s] & 0xffff] = static_cast<uint16_t>(chunk_.parts.size() + s);
    }
    return block;
  }

  /// `numbers`: the block of each pair of entries, in the order of the points.
  void CutIntoTiles(const std::vector<uint16_t>& numbers) {
    PointEntries entries(plan_, parts_);
    std::vector<uint8_t> has_square;
    std::vector<int> count;
    TileLists lists;
    lists.entry_pairs.reserve(numbers.size());
    const int64_t num_observations =
        plan_.first[chunk_.last_point] - plan_.first[chunk_.first_point];
    lists.observations.reserve(num_observations);
    KeyedItems<uint16_t> observations(num_observations);  // by images
    // By blocks; an entry may add its square.
    KeyedItems<EntryPair> pairs(numbers.size() + num_observations * plan_.num_kinds);
    const uint16_t* number = numbers.data();
    for (int p = chunk_.first_point; p < chunk_.last_point;) {
      pairs.size = observations.size = 0;
      int num_entries = 0;
      const int first_point = p;
      const int64_t begin = plan_.first[p];
      do {
        entries.Find(p, sizes_.num_refined(p));
        const int last_row = chunk_.last_row > 0 ? chunk_.last_row : entries.size();
        for (int i = 0; i < sizes_.num_refined(p); ++i) {
          if (chunk_.last_row > 0) {
            const int row = entries.RowOf(i);
            if (row < chunk_.first_row || row >= last_row) continue;
          }
          observations.Add(plan_.image_in_chunk[plan_.first[p] + i],
                           static_cast<uint16_t>(plan_.first[p] + i - begin));
        }
        if (p >= plan_.num_free_points) continue;
        NumberEntries(p, num_entries, entries, &has_square);
        entries.FindSquares(&has_square);
        for (int e = chunk_.first_row; e < last_row; ++e) {
          const auto first = static_cast<uint16_t>(num_entries + e);
          if (has_square[e]) {
            const auto at = std::lower_bound(chunk_.parts.begin(), chunk_.parts.end(), entries[e]);
            pairs.Add(static_cast<uint16_t>(at - chunk_.parts.begin()), {first, first});
          }
          for (int f = e + 1; plan_.has_pairs && f < entries.size(); ++f) {
            pairs.Add(*number++, {first, static_cast<uint16_t>(num_entries + f)});
          }
        }
        num_entries += entries.size();
      } while (++p < chunk_.last_point && p - first_point < kTilePoints &&
               plan_.first[p + 1] - begin <= kTileObservations);
      SortInto(pairs, chunk_.num_blocks(), &count, &lists.blocks, &lists.entry_pairs);
      SortInto(observations, static_cast<int>(chunk_.images.size()), &count, &lists.images,
               &lists.observations);
      chunk_.tiles.push_back(
          {p, static_cast<int>(lists.blocks.size()), static_cast<int>(lists.images.size())});
    }
    chunk_.tiles.shrink_to_fit();
    // Each with the memory that it needs, once.
    chunk_.tile_blocks.assign(lists.blocks.begin(), lists.blocks.end());
    chunk_.entry_pairs.assign(lists.entry_pairs.begin(), lists.entry_pairs.end());
    chunk_.tile_images.assign(lists.images.begin(), lists.images.end());
    chunk_.tile_observations.assign(lists.observations.begin(), lists.observations.end());
  }

  struct TileLists {
    std::vector<Tile::Block> blocks;
    std::vector<EntryPair> entry_pairs;
    std::vector<Tile::Image> images;
    std::vector<uint16_t> observations;
  };

  /// Items of a tile with their keys.
  template <typename Item>
  struct KeyedItems {
    explicit KeyedItems(size_t most) : keys(most), items(most) {}
    void Add(uint16_t key, Item item) {
      keys[size] = key;
      items[size++] = item;
    }
    std::vector<uint16_t> keys;
    std::vector<Item> items;
    size_t size = 0;
  };

  /// Appends the items in the order of their keys, 0 to num_keys - 1, and the count for each key
  /// that occurs.
  template <typename Item, typename KeyCount>
  static void SortInto(const KeyedItems<Item>& of, int num_keys, std::vector<int>* place,
                       std::vector<KeyCount>* counts, std::vector<Item>* sorted) {
    place->assign(num_keys, 0);
    for (size_t k = 0; k < of.size; ++k) ++(*place)[of.keys[k]];
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
    for (size_t k = 0; k < of.size; ++k) (*sorted)[(*place)[of.keys[k]]++] = of.items[k];
  }

  void NumberEntries(int point, int first_entry, const PointEntries& entries,
                     std::vector<uint8_t>* scratch) {
    std::vector<uint8_t>& is_seen = *scratch;
    is_seen.assign(entries.size(), 0);
    uint16_t* to = plan_.entry.data() + plan_.first[point] * plan_.num_kinds;
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

  const ImageParts& parts_;
  const PointSizes& sizes_;
  Chunk& chunk_;
  EliminationPlan& plan_;
};

}  // namespace

void NumberChunk(const ImageParts& parts, const PointSizes& sizes, ChunkDraft* draft, Chunk* chunk,
                 EliminationPlan* plan) {
  ChunkNumbering(parts, sizes, chunk, plan).Number(draft);
}

}  // namespace bundle
