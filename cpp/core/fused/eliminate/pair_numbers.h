#pragma once

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace bundle::fused {

/// Numbers the different pairs of 16-bit numbers in the order of their first appearance: a hash
/// table in one array, which grows with the pairs and is kept from one chunk to the next.
class PairNumbers {
 public:
  /// The number of a pair; where it is new, `next`, which is the count of those before. The members
  /// of a pair are below 0xffff.
  uint16_t Find(uint16_t a, uint16_t b, size_t next) {
    if (2 * next >= slots_.size()) Grow();
    Slot& slot = SlotOf(static_cast<uint32_t>(a) << 16 | b);
    if (slot.pair == kNone) {
      slot.pair = static_cast<uint32_t>(a) << 16 | b;
      slot.number = static_cast<uint16_t>(next);
    }
    return slot.number;
  }

  void Clear() { slots_.assign(slots_.size(), Slot{}); }

 private:
  static constexpr uint32_t kNone = 0xffffffff;
  struct Slot {
    uint32_t pair = kNone;
    uint16_t number = 0;
  };

  /// Where a pair is, or belongs.
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

  int shift_ = 22;
  std::vector<Slot> slots_ = std::vector<Slot>(1024);
};

}  // namespace bundle::fused
