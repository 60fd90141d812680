#pragma once

#include <bitset>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace bundle {

/// The keypoints of all images, one bit each: marked if the keypoint has a point.
///
/// Most keypoints of a model may have no point. Data of keypoints are therefore stored for marked
/// keypoints only. Their row is the number of marks before them, which takes constant time: each
/// block of 64 bits knows the number of marks before it. This needs two bits per keypoint.
class MarkedKeypoints {
 public:
  void Add(bool is_marked) {
    const size_t bit = size_ % 64;
    if (bit == 0) blocks_.push_back({0, num_marked_});
    if (is_marked) {
      blocks_.back().marks |= uint64_t{1} << bit;
      ++num_marked_;
    }
    ++size_;
  }

  size_t size() const { return size_; }

  bool IsMarked(size_t keypoint) const {
    return ((blocks_[keypoint / 64].marks >> (keypoint % 64)) & 1) != 0;
  }

  /// Number of marks before a keypoint, which may be the end.
  size_t Row(size_t keypoint) const {
    if (keypoint == size_) return num_marked_;
    const Block& block = blocks_[keypoint / 64];
    const uint64_t before = (uint64_t{1} << (keypoint % 64)) - 1;
    return block.num_before + std::bitset<64>(block.marks & before).count();
  }

 private:
  struct Block {
    uint64_t marks;
    uint64_t num_before;
  };
  std::vector<Block> blocks_;
  size_t size_ = 0;
  size_t num_marked_ = 0;
};

}  // namespace bundle
