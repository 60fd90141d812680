#pragma once

/// Entries and sizes of the points of an elimination plan.

#include <algorithm>
#include <cstdint>
#include <functional>
#include <vector>

#include "core/schur/elimination_plan.h"
#include "core/schur/image_parts.h"
#include "core/schur/sort_points.h"
#include "core/scratch/large_vector.h"

namespace bundle {

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
    is_plain_ = falls == list_.end() && plan_.num_kinds == 1 && size() == num_refined;
    if (falls == list_.end()) return;
    std::sort(list_.begin(), list_.end());
    list_.erase(std::unique(list_.begin(), list_.end()), list_.end());
  }

  const std::vector<int>& list() const { return list_; }
  int size() const { return static_cast<int>(list_.size()); }
  int num_refined() const { return num_refined_; }
  int operator[](int entry) const { return list_[entry]; }
  int PartOf(int i, int kind) const { return parts_.part_of(plan_.image[first_ + i], kind); }

  /// Index in list() of the part of this kind of observation i; -1 if it has none.
  int EntryOf(int i, int kind) const {
    if (is_plain_) return i;
    const int part = PartOf(i, kind);
    if (part < 0) return -1;
    return static_cast<int>(std::lower_bound(list_.begin(), list_.end(), part) - list_.begin());
  }

  /// The entry in whose row an observation's diagonal products are added.
  int RowOf(int i) const {
    int entry = -1;
    for (int kind = 0; kind < plan_.num_kinds && entry < 0; ++kind) entry = EntryOf(i, kind);
    return entry;
  }

  /// Sets to 1 where the product of an entry with itself is among the pairs. The product of an own
  /// part that occurs once is not, because the diagonal includes it (kernels/eliminate_point.h).
  void FindSquares(std::vector<uint8_t>* has_square) const {
    has_square->assign(list_.size(), is_plain_ ? 0 : 1);
    for (int i = 0; i < num_refined_ && !is_plain_; ++i) {
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
  bool is_plain_ = false;  ///< entry i is the one part of observation i
  std::vector<int> list_;
};

/// Sizes of the points of a sorted plan, which must outlive them.
class PointSizes {
 public:
  PointSizes(const EliminationPlan& plan, const ImageOrder& images, const ImageParts& parts,
             ThreadPool* pool);

  /// Observations with something to refine; they come first.
  int num_refined(int point) const { return num_refined_[point]; }
  int num_entries(int point) const { return num_entries_[point]; }
  bool HasPairs(int point) const { return plan_.has_pairs && point < plan_.num_free_points; }
  int64_t NumObservations(int point) const { return plan_.first[point + 1] - plan_.first[point]; }
  int64_t NumPairs(int point) const {
    const int64_t entries = HasPairs(point) ? num_entries_[point] : 0;
    return entries * (entries - 1) / 2;
  }

  /// Work of the products: an observation counts one, a pair half.
  int64_t Work(int point) const { return NumObservations(point) + NumPairs(point) / 2; }
  int64_t Work(int begin, int end) const {
    int64_t work = 0;
    for (int p = begin; p < end; ++p) work += Work(p);
    return work;
  }

 private:
  const EliminationPlan& plan_;
  LargeVector<int> num_refined_, num_entries_;
};

}  // namespace bundle
