#include "core/schur/assembly/ordered_sums.h"

#include <algorithm>
#include <cstddef>
#include <numeric>
#include <utility>

#include "core/linear/block_structure.h"
#include "core/schur/assembly/assembler.h"
#include "core/schur/assembly/sum_grid.h"
#include "core/sums/double_double.h"

namespace bundle {

int64_t PlaceBlocks(const EliminationInput& input, const Chunk& chunk,
                    std::vector<int64_t>* block_begin) {
  int64_t end = 0;
  block_begin->clear();
  const auto place = [&](size_t first, size_t second) {
    block_begin->push_back(end);
    end += int64_t{4} * input.part_rows[chunk.parts[first]] * input.part_quads[chunk.parts[second]];
  };
  for (size_t i = 0; i < chunk.parts.size(); ++i) place(i, i);
  for (const Chunk::Pair& pair : chunk.pairs) place(pair.first, pair.second);
  block_begin->push_back(end);
  return end;
}

OrderedSums::OrderedSums(const EliminationInput& input, const BlockStructure& structure,
                         const Assembler& assembler, int num_own_parts, int num_threads,
                         bool wants_camera_diagonal, bool keeps_error_terms)
    : input_(input),
      structure_(structure),
      assembler_(assembler),
      wants_camera_diagonal_(wants_camera_diagonal),
      chunks_have_camera_diagonal_(wants_camera_diagonal || assembler.has_maps()),
      waiting_(num_threads),
      last_added_(num_own_parts) {
  sums_.has_error_terms = keeps_error_terms;
  // Allocates all memory here, so that no pass can fail half way.
  size_t parts = 0, pairs = 0, blocks = 0, doubles = 0, diagonal = 0;
  std::vector<int64_t> block_begin;
  for (const Chunk& chunk : input.plan->chunks) {
    parts = std::max(parts, chunk.parts.size());
    pairs = std::max(pairs, chunk.pairs.size());
    blocks = std::max<size_t>(blocks, chunk.num_blocks());
    doubles = std::max<size_t>(doubles, PlaceBlocks(input, chunk, &block_begin));
    diagonal = std::max<size_t>(diagonal, block_begin[chunk.parts.size()]);
  }
  for (Waiting& waiting : waiting_) {
    if (assembler.own_parts_have_shared_blocks()) {
      waiting.second_begin.reserve(parts + 2);
      waiting.seconds.reserve(pairs);
    }
    for (Buffer& buffer : waiting.buffers) {
      buffer.blocks.reserve(doubles);
      buffer.block_begin.reserve(blocks + 1);
      buffer.vectors.reserve(parts * ChunkSum::kVectors * input.part_columns);
      if (chunks_have_camera_diagonal_) buffer.camera_diagonal.reserve(diagonal);
    }
  }
  MakeSystem();
}

void OrderedSums::MakeSystem() {
  sums_.system.values.resize(structure_.num_values);
  if (sums_.has_error_terms) {
    sums_.error_terms.values.resize(static_cast<size_t>(assembler_.num_error_terms()));
  }
  is_new_ = true;
}

void OrderedSums::Clear(ThreadPool* pool) {
  if (sums_.system.values.empty()) MakeSystem();
  if (!std::exchange(is_new_, false)) {
    pool->Run([&](int thread) {
      for (BlockValues* const values : {&sums_.system.values, &sums_.error_terms.values}) {
        const auto size = static_cast<int64_t>(values->size());
        const int64_t threads = pool->num_threads();
        std::fill(values->data() + size * thread / threads,
                  values->data() + size * (thread + 1) / threads, 0.0);
      }
    });
  }
  const auto n = static_cast<size_t>(structure_.num_columns());
  sums_.system.rhs.assign(n, 0.0);
  sums_.gradient.assign(n, 0.0);
  sums_.squared_norms.assign(n, 0.0);
  if (wants_camera_diagonal_) {
    sums_.system.camera_diagonal.assign(assembler_.diagonal_begin().back(), 0.0);
  }
  if (sums_.has_error_terms) {
    sums_.error_terms.rhs.assign(n, 0.0);
    sums_.error_terms.gradient.assign(n, 0.0);
    sums_.error_terms.squared_norms.assign(n, 0.0);
    sums_.error_terms.camera_diagonal.assign(sums_.system.camera_diagonal.size(), 0.0);
  }
  for (std::atomic<int>& last : last_added_) last.store(-1, std::memory_order_relaxed);
  num_added_.store(0, std::memory_order_relaxed);
  abandoned_.store(false, std::memory_order_relaxed);
  for (Waiting& waiting : waiting_) waiting.count = 0;  // chunks left by an abandoned pass
}

void OrderedSums::FreeSystem() {
  BlockValues().swap(sums_.system.values);
  BlockValues().swap(sums_.error_terms.values);
}

ChunkSum& OrderedSums::Begin(int chunk, int thread) {
  Waiting& waiting = waiting_[thread];
  if (waiting.IsFull()) AddOldest(&waiting);
  Buffer& buffer = waiting.Push();
  buffer.chunk = chunk;
  const Chunk& what = input_.plan->chunks[chunk];
  buffer.blocks.assign(PlaceBlocks(input_, what, &buffer.block_begin), 0.0);
  buffer.vectors.assign(what.parts.size() * ChunkSum::kVectors * input_.part_columns, 0.0);
  buffer.sum = {};
  buffer.sum.blocks = buffer.blocks.data();
  buffer.sum.block_begin = buffer.block_begin.data();
  buffer.sum.vectors = buffer.vectors.data();
  if (chunks_have_camera_diagonal_) {
    buffer.camera_diagonal.assign(buffer.block_begin[what.parts.size()], 0.0);
    buffer.sum.camera_diagonal = buffer.camera_diagonal.data();
  }
  if (HasGrid()) grid_->Start(what, &buffer.sum);
  return buffer.sum;
}

bool OrderedSums::HasGrid() const { return grid_ != nullptr && grid_->is_chosen(); }

void OrderedSums::End(int thread) {
  Waiting& waiting = waiting_[thread];
  while (!waiting.IsEmpty() &&
         num_added_.load(std::memory_order_acquire) == waiting.Oldest().chunk) {
    AddOldest(&waiting);
  }
}

void OrderedSums::Flush(int thread) {
  while (!waiting_[thread].IsEmpty()) AddOldest(&waiting_[thread]);
}

void OrderedSums::WaitFor(const std::atomic<int>& value, int wanted) const {
  for (SpinWait wait; value.load(std::memory_order_acquire) != wanted; wait.Once()) {
    if (abandoned_.load(std::memory_order_acquire)) throw Abandoned();
  }
}

void OrderedSums::GroupBySecond(const Chunk& chunk, Waiting* waiting) {
  std::vector<int>& begin = waiting->second_begin;
  begin.assign(chunk.parts.size() + 2, 0);
  for (const Chunk::Pair& pair : chunk.pairs) ++begin[pair.second + 2];
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  waiting->seconds.resize(chunk.pairs.size());
  int index = 0;
  for (const Chunk::Pair& pair : chunk.pairs) {
    waiting->seconds[begin[pair.second + 1]++] = index++;
  }
}

void OrderedSums::AddOldest(Waiting* waiting) {
  Buffer& buffer = waiting->Oldest();
  const int c = buffer.chunk;
  const Chunk& chunk = input_.plan->chunks[c];
  if (HasGrid()) grid_->Finish(chunk, &buffer.sum);
  const bool has_shared_blocks = assembler_.own_parts_have_shared_blocks();
  if (has_shared_blocks) GroupBySecond(chunk, waiting);
  Assembler::PairsOfPart pairs;
  for (int i = 0; i < chunk.num_own_parts; ++i) {
    pairs.first = pairs.last;
    while (pairs.last < chunk.pairs.size() && chunk.pairs[pairs.last].first == i) ++pairs.last;
    if (has_shared_blocks) {
      const int begin = waiting->second_begin[i], end = waiting->second_begin[i + 1];
      pairs.as_second = waiting->seconds.data() + begin;
      pairs.num_as_second = end - begin;
    }
    std::atomic<int>& last_added = last_added_[chunk.parts[i]];
    WaitFor(last_added, chunk.previous_chunk[i]);
    assembler_.AddPart(input_, chunk, buffer.sum, i, pairs, &sums_);
    last_added.store(c, std::memory_order_release);
  }
  WaitFor(num_added_, c);
  assembler_.AddSharedBlocks(input_, chunk, buffer.sum, &sums_);
  num_added_.store(c + 1, std::memory_order_release);
  waiting->Pop();
}

void Assembler::Round(ThreadPool* pool, CameraSums* sums) const {
  if (!sums->has_error_terms) return;
  CameraSums::ErrorTerms& error_terms = sums->error_terms;
  const auto round = [](const std::vector<double>& error, std::vector<double>* sum) {
    for (size_t i = 0; i < sum->size(); ++i) (*sum)[i] = RoundDoubleDouble((*sum)[i], error[i]);
  };
  round(error_terms.gradient, &sums->gradient);
  round(error_terms.squared_norms, &sums->squared_norms);
  round(error_terms.rhs, &sums->system.rhs);
  round(error_terms.camera_diagonal, &sums->system.camera_diagonal);
  constexpr int kColumnsAtOnce = 16;
  std::atomic<int> next{0};
  pool->Run([&](int /*thread*/) {
    const int count = structure_.num_blocks();
    for (int at = next.fetch_add(kColumnsAtOnce); at < count; at = next.fetch_add(kColumnsAtOnce)) {
      for (int j = at; j < std::min(at + kColumnsAtOnce, count); ++j) RoundColumn(j, sums);
    }
  });
}

void Assembler::RoundColumn(int j, CameraSums* sums) const {
  for (int64_t e = structure_.column_begin[j]; e < structure_.column_begin[j + 1]; ++e) {
    const int height = structure_.block_size(structure_.row_block[e]);
    for (int c = 0; c < structure_.block_size(j); ++c) {
      const Target column = Block(sums, j, e, 0, c);
      for (int r = 0; r < height; ++r) {
        column.sum[r] = RoundDoubleDouble(column.sum[r], column.error[r]);
      }
    }
  }
}

void Assembler::AddDamping(double damping, const std::vector<double>& d_squared,
                           CameraSums* sums) const {
  for (int b = 0; b < structure_.num_blocks(); ++b) {
    const int size = structure_.block_size(b);
    for (int k = 0; k < size; ++k) {
      const double added = damping * d_squared[structure_.offset[b] + k];
      sums->system.values[structure_.ValueIndex(b, structure_.column_begin[b], k, k)] += added;
      if (sums->system.camera_diagonal.empty()) continue;
      double* const diagonal = sums->system.camera_diagonal.data() + diagonal_begin_[b];
      diagonal[k * size + k] += added;
      for (int i = 0; i < k; ++i) diagonal[k * size + i] = diagonal[i * size + k];
    }
  }
}

void Assembler::ClearColumns(const std::vector<uint8_t>& which, CameraSums* sums) const {
  if (std::count(which.begin(), which.end(), 1) == 0) return;
  for (size_t j = 0; j < which.size(); ++j) {
    if (which[j]) sums->gradient[j] = sums->system.rhs[j] = sums->squared_norms[j] = 0;
  }
  for (int b = 0; b < structure_.num_blocks(); ++b) {
    const uint8_t* const columns = which.data() + structure_.offset[b];
    const int width = structure_.block_size(b);
    for (int64_t e = structure_.column_begin[b]; e < structure_.column_begin[b + 1]; ++e) {
      const uint8_t* const rows = which.data() + structure_.offset[structure_.row_block[e]];
      const int height = structure_.block_size(structure_.row_block[e]);
      for (int k = 0; k < width; ++k) {
        for (int i = 0; i < height; ++i) {
          if (columns[k] || rows[i]) sums->system.values[structure_.ValueIndex(b, e, i, k)] = 0;
        }
      }
    }
    if (sums->system.camera_diagonal.empty()) continue;
    double* const diagonal = sums->system.camera_diagonal.data() + diagonal_begin_[b];
    for (int k = 0; k < width; ++k) {
      for (int i = 0; i < width; ++i) {
        if (columns[k] || columns[i]) diagonal[k * width + i] = 0;
      }
    }
  }
}

}  // namespace bundle
