#pragma once

#include <algorithm>
#include <atomic>
#include <vector>

#include "core/fused/eliminate/assembler.h"
#include "core/fused/eliminate/kernels.h"
#include "core/fused/thread_pool.h"

namespace bundle::fused {

/// Sums up chunks that several threads work on, in the order of the chunks, so that no bit of the
/// sum depends on who was faster.
///
/// Each image's block column of S is a queue of its own: threads wait for each other at the same
/// column only. A thread that is early keeps its chunk and goes on to the next.
class OrderedSums {
 public:
  /// Keeps references to all but the last.
  OrderedSums(const Terms& terms, const ReducedStructure& structure, const Assembler& assembler,
              int num_images, int num_threads, bool wants_camera_diagonal);

  /// Starts anew, at zero.
  void Clear(ThreadPool* pool);

  /// Zeros for a thread to sum up a chunk in, until it calls End.
  ChunkSum& Begin(int chunk, int thread);
  void End(int thread);

  /// Adds what a thread still keeps, after its last chunk.
  void Flush(int thread);

  /// Thrown by the above where they would wait for a chunk that never comes.
  struct Abandoned {};

  /// A thread will not end its chunk: the others do not wait for it. Until Clear.
  void Abandon() { abandoned_.store(true, std::memory_order_release); }

  CameraSums& sums() { return sums_; }

  /// Frees S, until Clear.
  void FreeSystem();

 private:
  struct Buffer {
    std::vector<double> blocks, vectors, camera_diagonal;
    std::vector<int64_t> block_begin;  ///< ChunkSum::block_begin
    ChunkSum sum;
    int chunk = -1;
  };

  /// A thread's chunks that wait for those before them, a short queue. The buffer that was freed
  /// last is taken next, as it is still in the cache; most problems touch no other.
  struct Waiting {
    static constexpr int kBuffers = 3;
    Buffer buffers[kBuffers];
    int order[kBuffers] = {0, 1, 2};  ///< those in the queue, oldest first, then the free ones
    int count = 0;

    bool IsEmpty() const { return count == 0; }
    bool IsFull() const { return count == kBuffers; }
    Buffer& Oldest() { return buffers[order[0]]; }
    Buffer& Push() { return buffers[order[count++]]; }
    void Pop() {
      std::rotate(order, order + 1, order + count);
      --count;
    }
  };

  /// Where a chunk's blocks begin, and how many doubles they are, where widths are mixed.
  int64_t PlaceBlocks(const Chunk& chunk, std::vector<int64_t>* block_begin) const;

  void MakeSystem();
  void AddOldest(Waiting* waiting);
  void WaitFor(const std::atomic<int>& value, int wanted) const;

  const Terms& terms_;
  const ReducedStructure& structure_;
  const Assembler& assembler_;
  const bool wants_camera_diagonal_;
  CameraSums sums_;
  bool is_new_ = false;                       ///< S, and zero therefore
  std::vector<Waiting> waiting_;              ///< of each thread
  std::vector<std::atomic<int>> last_added_;  ///< chunk, of each image
  std::atomic<int> num_added_{0};             ///< chunks
  std::atomic<bool> abandoned_{false};
};

}  // namespace bundle::fused
