#pragma once

/// Sums over chunks, in the order of the chunks for any number of threads.

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/parallel/thread_pool.h"
#include "core/schur/assembly/assembler.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/kernels/kernels.h"

namespace bundle {

class SumGrid;  // sum_grid.h

/// Writes the offset of each block of a chunk to `block_begin` (ChunkSum), then the end, and
/// returns the end.
int64_t PlaceBlocks(const EliminationInput& input, const Chunk& chunk,
                    std::vector<int64_t>* block_begin);

/// Sums over chunks that several threads compute. Chunks are added in their order, so that the bits
/// of a sum do not depend on the speed of threads.
///
/// Threads wait for each other only at the same queue (Assembler). A thread that finishes early
/// keeps its chunk and computes the next one.
class OrderedSums {
 public:
  /// Keeps references to all arguments but the last. `keeps_error_terms`: the sums are
  /// double-doubles until Round.
  OrderedSums(const EliminationInput& input, const BlockStructure& structure,
              const Assembler& assembler, int num_own_parts, int num_threads,
              bool wants_camera_diagonal, bool keeps_error_terms);

  /// Makes sums on a grid, if one is chosen, from the next Clear on. nullptr: without a grid.
  void UseGrid(const SumGrid* grid) { grid_ = grid; }

  /// Starts anew, at zero.
  void Clear(ThreadPool* pool);

  /// Buffer in which a thread sums up a chunk until it calls End. It starts at zero, or at the
  /// start values of sums on the grid.
  ChunkSum& Begin(int chunk, int thread);
  void End(int thread);

  /// Adds the chunks that a thread still keeps. Call after its last chunk.
  void Flush(int thread);

  /// Exception of the methods above if they would wait for an abandoned chunk.
  struct Abandoned {};

  /// Abandons a chunk that its thread will not end. The other threads do not wait for it until the
  /// next Clear.
  void Abandon() { abandoned_.store(true, std::memory_order_release); }

  CameraSums& sums() { return sums_; }

  /// Frees S until the next Clear.
  void FreeSystem();

 private:
  struct Buffer {
    ArenaVector<double> blocks, vectors, camera_diagonal;
    std::vector<int64_t> block_begin;  ///< ChunkSum::block_begin
    ChunkSum sum;
    int chunk = -1;
  };

  /// Chunks of a thread that wait for earlier chunks: a short queue. The buffer that was freed last
  /// is used next, because it is still in the cache. Most problems use only this one.
  struct Waiting {
    static constexpr int kBuffers = 3;
    Buffer buffers[kBuffers];
    int order[kBuffers] = {0, 1, 2};  ///< buffers in the queue, oldest first, then free buffers
    int count = 0;

    std::vector<int> second_begin, seconds;  ///< GroupBySecond

    bool IsEmpty() const { return count == 0; }
    bool IsFull() const { return count == kBuffers; }
    Buffer& Oldest() { return buffers[order[0]]; }
    Buffer& Push() { return buffers[order[count++]]; }
    void Pop() {
      std::rotate(order, order + 1, order + count);
      --count;
    }
  };

  /// The pairs of a chunk by their second part. Those of part i are seconds[second_begin[i]] to
  /// seconds[second_begin[i + 1]], ascending.
  static void GroupBySecond(const Chunk& chunk, Waiting* waiting);

  void MakeSystem();
  bool HasGrid() const;
  void AddOldest(Waiting* waiting);
  void WaitFor(const std::atomic<int>& value, int wanted) const;

  const EliminationInput& input_;
  const BlockStructure& structure_;
  const Assembler& assembler_;
  const bool wants_camera_diagonal_;
  const bool chunks_have_camera_diagonal_;
  const SumGrid* grid_ = nullptr;
  CameraSums sums_;
  bool is_new_ = false;                       ///< S was just allocated and is already zero
  std::vector<Waiting> waiting_;              ///< per thread
  std::vector<std::atomic<int>> last_added_;  ///< last added chunk of each own part
  std::atomic<int> num_added_{0};             ///< number of added chunks
  std::atomic<bool> abandoned_{false};
};

}  // namespace bundle
