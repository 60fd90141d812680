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
  std::vector<double> of_points;  ///< results of a kernel
  std::vector<ObservationLeverage> of_observations;
  int thread = 0;
};

template <typename Visit>
void PointPasses::ForChunks(const BlockStructure& structure, const BlockValues* values,
                            bool both_ways, const Visit& visit) const {
  const SchurSetup& setup = schur_.setup();
  const EliminationInput& input = schur_.input();
  const auto num_chunks = static_cast<int>(setup.plan.chunks.size());
  std::atomic<int> next{0};
  RunOnThreads(num_threads_, [&](int64_t thread) {
    Room room;
    room.thread = static_cast<int>(thread);
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
    room->of_points.resize(9 * count);
    setup.kernels.point_covariances(schur_.input(), schur_.records(), chunk, moves, room->blocks,
                                    room->begin.data(), room->memory, room->of_points.data());
    CopyToPoints(chunk, count, room->of_points, to);
  });
}

/// Nine numbers per point.
void PointPasses::CopyToPoints(const Chunk& chunk, int64_t count, const std::vector<double>& from,
                               double* to) const {
  for (int64_t k = 0; k < count; ++k) {
    std::copy_n(&from[9 * k], 9,
                to + 9 * int64_t{schur_.setup().plan.point[chunk.first_point + k]});
  }
}

/// Columns by unknown, `width` numbers in a row, by columns of the parts.
std::vector<double> PointPasses::ByPart(const double* by_unknown, int width) const {
  const size_t stride = size_t(schur_.input().part_columns) * width;
  std::vector<double> by_part(blocks_.size() * stride);
  for (size_t part = 0; part < blocks_.size(); ++part) {
    for (const ColumnBlock& block : blocks_[part]) {
      const double* from = by_unknown + schur_.setup().layout.blocks()[block.block].offset * width;
      for (int k = 0; k < block.size; ++k, from += width) {
        const auto add = [&](size_t column, double factor) {
          double* const to = &by_part[part * stride + column * width];
          for (int m = 0; m < width; ++m) to[m] += factor * from[m];
        };
        if (block.map.empty()) add(block.column[k], 1);
        for (size_t c = 0; c < block.map.size() / block.size; ++c) {
          add(c, block.map[c * block.size + k]);
        }
      }
    }
  }
  return by_part;
}

void PointPasses::FindMovements(const double* by_unknown, int num_quads,
                                const std::vector<uint8_t>& is_wanted,
                                const MovementVisitor& visit) const {
  const SchurSetup& setup = schur_.setup();
  const std::vector<double> steps = ByPart(by_unknown, 4 * num_quads);
  const int64_t size = 9 + 12 * int64_t{num_quads};
  ForChunks({}, nullptr, false, [&](const Chunk& chunk, int last_point, Room* room) {
    const int* const points = setup.plan.point.data();
    if (std::none_of(points + chunk.first_point, points + last_point,
                     [&](int p) { return is_wanted[p] != 0; })) {
      return;
    }
    room->of_points.resize(size * (last_point - chunk.first_point));
    setup.kernels.point_movements(schur_.input(), schur_.records(), chunk, steps.data(), num_quads,
                                  room->memory, room->of_points.data());
    const double* found = room->of_points.data();
    for (int k = chunk.first_point; k < last_point; ++k, found += size) {
      if (is_wanted[points[k]] != 0) visit(points[k], found, found + 9, room->thread);
    }
  });
}

void PointPasses::FindLeverages(const BlockStructure& structure, const BlockValues* values,
                                const double* adjoint, double* covariances,
                                const LeverageVisitor& visit) const {
  const SchurSetup& setup = schur_.setup();
  const EliminationPlan& plan = setup.plan;
  const std::vector<double> by_part =
      adjoint == nullptr ? std::vector<double>() : ByPart(adjoint, 1);
  const std::vector<HeldResidual>& held = schur_.held();
  const auto is_before = [](const HeldResidual& one, int64_t i) { return one.observation < i; };
  ForChunks(structure, values, true, [&](const Chunk& chunk, int last_point, Room* room) {
    const int64_t first = plan.first[chunk.first_point], last = plan.first[last_point];
    const int64_t num_points = last_point - chunk.first_point;
    room->of_observations.resize(std::max<size_t>(room->of_observations.size(), last - first));
    if (covariances != nullptr) room->of_points.resize(9 * num_points);
    ObservationLeverage* const found = room->of_observations.data();
    const LeverageInput given = {values == nullptr ? nullptr : room->blocks, room->begin.data(),
                                 adjoint == nullptr ? nullptr : by_part.data()};
    setup.kernels.point_leverages(schur_.input(), schur_.records(), chunk, given, room->memory,
                                  found, covariances == nullptr ? nullptr : room->of_points.data());
    if (covariances != nullptr) CopyToPoints(chunk, num_points, room->of_points, covariances);
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
