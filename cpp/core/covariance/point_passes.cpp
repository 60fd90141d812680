#include "core/covariance/point_passes.h"

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <memory>
#include <utility>

#include "core/parallel/thread_pool.h"
#include "core/schur/assembly/ordered_sums.h"

namespace bundle {
namespace {

/// Reserves this many doubles, aligned to a cache line, for fast reads of full lines.
double* Aligned(int64_t count, std::vector<double>* room) {
  constexpr size_t kLine = 64;
  room->resize(static_cast<size_t>(count) + kLine / sizeof(double));
  void* begin = room->data();
  size_t space = room->size() * sizeof(double);
  return static_cast<double*>(std::align(kLine, sizeof(double), begin, space));
}

}  // namespace

PointPasses::PointPasses(const SchurProblem& schur, int num_threads)
    : schur_(schur), num_threads_(num_threads) {
  const SchurSetup& setup = schur_.setup();
  blocks_.resize(setup.parts.num_parts());
  for (int p = 0; p < setup.parts.num_parts(); ++p) {
    for (int b = 0; b < setup.assembler.num_blocks(p); ++b) {
      const PartBlock& of = setup.assembler.blocks_of(p)[b];
      ColumnBlock block{of.block, of.size, {}, -1, {}};
      if (of.map == nullptr) {
        block.column.assign(of.local, of.local + of.size);
        if (of.is_contiguous) block.first = of.local[0];
      } else {
        block.map.assign(size_t(NumColumns(p)) * of.size, 0.0);
        for (int k = 0; k < of.num_local; ++k) {
          std::copy_n(of.map + k * of.size, of.size, &block.map[size_t(of.local[k]) * of.size]);
        }
      }
      blocks_[p].push_back(std::move(block));
    }
  }
}

void PointPasses::AddPlain(const BlockStructure& structure, const BlockValues& values,
                           const ColumnBlock& rows, const ColumnBlock& columns, int width,
                           double* to) {
  if (rows.block >= columns.block || columns.first < 0) {
    double own[BlockSystem::kMaxBlockSize * BlockSystem::kMaxBlockSize];
    CopyBlock(structure, values, rows.block, columns.block, own);
    for (int r = 0; r < rows.size; ++r) {
      double* const row = to + rows.column[r] * width;
      for (int c = 0; c < columns.size; ++c) row[columns.column[c]] += own[r * columns.size + c];
    }
    return;
  }
  // Stored transposed: a row of the requested block is a column there.
  const int64_t entry = structure.Entry(rows.block, columns.block);
  const double* from = values.data() + structure.ValueIndex(rows.block, entry, 0, 0);
  for (int r = 0; r < rows.size; ++r, from += structure.panel_stride[rows.block]) {
    double* const row = to + rows.column[r] * width + columns.first;
    for (int c = 0; c < columns.size; ++c) row[c] += from[c];
  }
}

void PointPasses::FillPair(const BlockStructure& structure, const BlockValues& values, int a, int b,
                           double* to) const {
  constexpr int kMax = BlockSystem::kMaxBlockSize;
  const int width = Width(b);
  for (const ColumnBlock& rows : blocks_[a]) {
    for (const ColumnBlock& columns : blocks_[b]) {
      if (rows.map.empty() && columns.map.empty()) {
        AddPlain(structure, values, rows, columns, width, to);
        continue;
      }
      double own[kMax * kMax], half[kMaxMapped];
      CopyBlock(structure, values, rows.block, columns.block, own);
      // half = C M_b^T, then M_a times that.
      std::fill_n(half, rows.size * width, 0.0);
      for (int r = 0; r < rows.size; ++r) {
        for (int k = 0; k < columns.size; ++k) {
          const double value = own[r * columns.size + k];
          if (columns.map.empty()) {
            half[r * width + columns.column[k]] += value;
            continue;
          }
          for (int c = 0; c < NumColumns(b); ++c) {
            half[r * width + c] += value * columns.map[size_t(c) * columns.size + k];
          }
        }
      }
      for (int r = 0; r < NumColumns(a); ++r) {
        for (int k = 0; k < rows.size; ++k) {
          const double factor = rows.map.empty() ? (rows.column[k] == r ? 1 : 0)
                                                 : rows.map[size_t(r) * rows.size + k];
          if (factor == 0) continue;
          for (int c = 0; c < NumColumns(b); ++c) to[r * width + c] += factor * half[k * width + c];
        }
      }
    }
  }
}

struct PointPasses::Room {
  std::vector<double> of_memory, of_blocks;
  double* memory = nullptr;
  double* blocks = nullptr;
  std::vector<int64_t> begin;
};

template <typename Visit>
void PointPasses::ForChunks(const BlockStructure& structure, const BlockValues* values,
                            bool both_ways, const Visit& visit) const {
  const SchurSetup& setup = schur_.setup();
  const EliminationInput& input = schur_.input();
  const auto num_chunks = static_cast<int>(setup.plan.chunks.size());
  std::atomic<int> next{0};
  RunOnThreads(num_threads_, [&](int64_t) {
    Room room;
    room.memory =
        Aligned(setup.kernels.memory_doubles(input) + setup.kernels.scatter_doubles(input),
                &room.of_memory);
    try {
      for (int c = next.fetch_add(1); c < num_chunks; c = next.fetch_add(1)) {
        ThrowIfInterrupted();
        const Chunk& chunk = setup.plan.chunks[c];
        const int last_point = std::min(chunk.last_point, setup.plan.num_free_points);
        if (chunk.last_row > 0 || chunk.first_point >= last_point) continue;
        const std::vector<int>& parts = chunk.parts;
        int64_t end = PlaceBlocks(input, chunk, &room.begin);
        room.begin.pop_back();
        for (const Chunk::Pair& pair : chunk.pairs) {
          if (!both_ways) break;
          room.begin.push_back(end);
          end += int64_t{input.part_rows[parts[pair.second]]} * Width(parts[pair.first]);
        }
        room.begin.push_back(end);
        if (values != nullptr) {
          room.blocks = Aligned(end, &room.of_blocks);
          std::fill_n(room.blocks, end, 0.0);
          const auto fill = [&](int first, int second, size_t block) {
            FillPair(structure, *values, first, second, room.blocks + room.begin[block]);
          };
          for (size_t i = 0; i < parts.size(); ++i) fill(parts[i], parts[i], i);
          size_t block = parts.size();
          for (const Chunk::Pair& pair : chunk.pairs) {
            if (both_ways) fill(parts[pair.second], parts[pair.first], block + chunk.pairs.size());
            fill(parts[pair.first], parts[pair.second], block++);
          }
        }
        visit(chunk, last_point, &room);
      }
    } catch (...) {
      next.store(num_chunks);
      throw;
    }
  });
}

void PointPasses::FindCovariances(const BlockStructure& structure, const BlockValues& values,
                                  const FreeGauge* gauge, double* to) const {
  const SchurSetup& setup = schur_.setup();
  WorldMoves moves;
  if (gauge != nullptr) {
    std::copy_n(gauge->moves().center(), 3, moves.center);
    moves.size = gauge->moves().size();
    moves.combinations = gauge->combinations();
  }
  ForChunks(structure, &values, false, [&](const Chunk& chunk, int last_point, Room* room) {
    const int64_t count = last_point - chunk.first_point;
    std::vector<double> found(9 * count);
    setup.kernels.point_covariances(schur_.input(), schur_.records(), chunk, moves, room->blocks,
                                    room->begin.data(), room->memory, found.data());
    for (int64_t k = 0; k < count; ++k) {
      std::copy_n(&found[9 * k], 9, to + 9 * int64_t{setup.plan.point[chunk.first_point + k]});
    }
  });
}

void PointPasses::FindLeverages(const BlockStructure& structure, const BlockValues* values,
                                const double* adjoint, const LeverageVisitor& visit) const {
  const SchurSetup& setup = schur_.setup();
  const EliminationPlan& plan = setup.plan;
  const int stride = schur_.input().part_columns;
  std::vector<double> by_part(adjoint == nullptr ? 0 : blocks_.size() * stride);
  for (size_t part = 0; part < blocks_.size() && adjoint != nullptr; ++part) {
    for (const ColumnBlock& block : blocks_[part]) {
      const double* const from = adjoint + setup.layout.blocks()[block.block].offset;
      double* const to = &by_part[part * stride];
      for (int k = 0; k < block.size; ++k) {
        if (block.map.empty()) to[block.column[k]] += from[k];
        for (size_t c = 0; c < block.map.size() / block.size; ++c) {
          to[c] += block.map[c * block.size + k] * from[k];
        }
      }
    }
  }
  const std::vector<HeldResidual>& held = schur_.held();
  const auto is_before = [](const HeldResidual& one, int64_t i) { return one.observation < i; };
  ForChunks(structure, values, true, [&](const Chunk& chunk, int last_point, Room* room) {
    const int64_t first = plan.first[chunk.first_point], last = plan.first[last_point];
    std::vector<ObservationLeverage> found(last - first);
    const LeverageInput given = {values == nullptr ? nullptr : room->blocks, room->begin.data(),
                                 adjoint == nullptr ? nullptr : by_part.data()};
    setup.kernels.point_leverages(schur_.input(), schur_.records(), chunk, given, room->memory,
                                  found.data());
    auto next = std::lower_bound(held.begin(), held.end(), first, is_before);
    for (int64_t i = first; i < last; ++i) {
      if (next != held.end() && next->observation == i) {
        ++next;
      } else {
        visit(plan.observation[i], found[i - first]);
      }
    }
  });
}

}  // namespace bundle
