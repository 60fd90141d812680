#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace bundle {

/// Assigns numbers to the distinct pairs of 16-bit numbers in the order of their first appearance.
/// A table has a row for each first number: the pairs of a point then lie in few cache lines. Pairs
/// of large numbers are in a hash table, which grows. Both are reused for the next chunk.
class PairNumbers {
 public:
  /// The number of a pair. A new pair gets `next`, the count of earlier pairs. The members of a
  /// pair are below 0xffff.
  uint16_t Find(uint16_t a, uint16_t b, size_t next) {
    if (a < kRowSize && b < kRowSize) {
      if (a >= num_rows_) AddRows(a + 1);
      uint16_t& number = table_[a * kRowSize + b];
      if (number == kNoNumber) number = static_cast<uint16_t>(next);
      return number;
    }
    if (2 * next >= slots_.size()) Grow();
    Slot& slot = SlotOf(static_cast<uint32_t>(a) << 16 | b);
    if (slot.pair == kNone) {
      slot.pair = static_cast<uint32_t>(a) << 16 | b;
      slot.number = static_cast<uint16_t>(next);
    }
    return slot.number;
  }

  void Clear() {
    num_rows_ = 0;
    slots_.assign(slots_.size(), Slot{});
  }

 private:
  static constexpr size_t kRowSize = 512;  // the table fits the second-level cache
  static constexpr uint16_t kNoNumber = 0xffff;

  void AddRows(size_t num_rows) {
    table_.resize(std::max(table_.size(), num_rows * kRowSize));
    std::fill(table_.begin() + num_rows_ * kRowSize, table_.begin() + num_rows * kRowSize,
              kNoNumber);
    num_rows_ = num_rows;
  }

  static constexpr uint32_t kNone = 0xffffffff;
  struct Slot {
    uint32_t pair = kNone;
    uint16_t number = 0;
  };

  /// Slot of a pair, or the empty slot where it would be inserted.
  Slot& SlotOf(uint32_t pair) {
    constexpr uint32_t kGoldenRatio = 0x9e3779b9;
    size_t at = pair * kGoldenRatio >> shift_;
    while (slots_[at].pair != kNone && slots_[at].pair != pair) at = (at + 1) & (slots_.size() - 1);
    return slots_[at];
  }

  void Grow() {
    const std::vector<Slot> before = std::move(slots_);
    --shift_;
    slots_.assign(size_t{1} << (32 - shift_), Slot{});
    for (const Slot& slot : before) {
      if (slot.pair != kNone) SlotOf(slot.pair) = slot;
    }
  }

  std::vector<uint16_t> table_;
  size_t num_rows_ = 0;  ///< rows that are filled
  int shift_ = 22;
  std::vector<Slot> slots_ = std::vector<Slot>(1024);
};

}  // namespace bundle
