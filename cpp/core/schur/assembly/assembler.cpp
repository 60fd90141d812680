#include "core/schur/assembly/assembler.h"

#include <algorithm>

#include "core/sums/double_double.h"

namespace bundle {
namespace {

constexpr size_t kPairsAhead = 6;  // about the number of cache misses that a core handles at once

}  // namespace

Assembler::Assembler(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const ImageParts& parts, const Kernels& kernels,
                     const BlockStructure& structure, bool by_parts)
    : problem_(problem),
      layout_(layout),
      image_parts_(parts),
      kernels_(kernels),
      structure_(structure),
      parts_(parts.num_parts()),
      diagonal_begin_(DiagonalBlockOffsets(structure)) {
  for (int p = 0; p < parts.num_parts(); ++p) {
    const CameraPart& part = parts.part(p);
    parts_[p].num_columns = part.num_columns;
    if (by_parts) {
      AddWhole(p);
      continue;
    }
    if (part.kind == kSensorPart) {
      AddBlock(p, ParameterLayout::kSensorBlock);
      continue;
    }
    const bool has_camera_part = parts.part_of(part.image, kCameraPart) >= 0;
    AddBlock(p,
             part.kind == kOwnPart ? ParameterLayout::kPoseBlock : ParameterLayout::kCameraBlock);
    if (part.kind == kCameraPart || !has_camera_part) AddBlock(p, ParameterLayout::kTiedBlock);
    if (part.kind != kOwnPart) continue;
    for (const int place : {ParameterLayout::kBeforeBlock, ParameterLayout::kAfterBlock,
                            ParameterLayout::kReadoutBlock}) {
      AddBlock(p, place);
    }
  }
  map_values_.resize(map_values_.size() + kMaxMapColumns);  // map_block reads past the last row
  // The addresses of the values do not change from here on.
  for (const MapOf& map : maps_) parts_[map.part].of[map.k].map = &map_values_[map.first];
}

void Assembler::SetMaps(const CameraStates& cameras) {
  for (const MapOf& of : maps_) {
    const int image = image_parts_.part(of.part).image;
    const bool is_constant =
        of.place != ParameterLayout::kPoseBlock && of.place < ParameterLayout::kBeforeBlock;
    if (is_constant) continue;
    ColumnMap map;
    layout_.FillMap(problem_, image, of.place, cameras.pose(image), cameras.twist_map(image), &map);
    std::copy_n(map.values, map.num_columns * parts_[of.part].of[of.k].size,
                &map_values_[of.first]);
  }
}

void Assembler::AddBlock(int part, int place) {
  const CameraPart& of_part = image_parts_.part(part);
  const int block = layout_.blocks_of(of_part.image)[place];
  if (block < 0) return;
  const CameraBlock& columns = layout_.blocks()[block];
  const int8_t* local = columns.columns;
  ColumnMap map;
  PartBlock& added = parts_[part].of[parts_[part].count];
  added.block = block;
  added.size = added.num_local = columns.size;
  added.is_shared = place != ParameterLayout::kPoseBlock || layout_.HasHardTwists();
  own_parts_have_shared_blocks_ |= added.is_shared && of_part.kind == kOwnPart;
  if (place != ParameterLayout::kSensorBlock && layout_.HasMap(problem_, of_part.image, place)) {
    maps_.push_back({part, place, parts_[part].count, map_values_.size()});
    layout_.FillMap(problem_, of_part.image, place, PoseState(), nullptr, &map);
    map_values_.insert(map_values_.end(), map.values, map.values + map.num_columns * columns.size);
    added.num_local = map.num_columns;
    local = map.columns;
  }
  ++parts_[part].count;
  for (int k = 0; k < added.num_local; ++k) {
    const int8_t* const end = of_part.columns + of_part.num_columns;
    added.local[k] =
        static_cast<int8_t>(std::find(of_part.columns, end, local[k]) - of_part.columns);
    added.is_contiguous &= added.local[k] == added.local[0] + k;
  }
}

void Assembler::AddWhole(int part) {
  PartBlock& added = parts_[part].of[parts_[part].count++];
  added.block = part;
  added.size = image_parts_.part(part).num_columns;
  added.is_shared = image_parts_.part(part).kind != kOwnPart;
  added = added.WithoutMap();
}

void Assembler::Target::Add(int64_t i, double value) const {
  if (error == nullptr) {
    sum[i] += value;
  } else {
    AddDoubleDouble(value, sum + i, error + i);
  }
}

Assembler::Target Assembler::Block(CameraSums* sums, int column, int64_t entry, int r,
                                   int c) const {
  Target target;
  target.sum = sums->system.values.data() + structure_.ValueIndex(column, entry, r, c);
  if (sums->has_error_terms) {
    const int height = structure_.block_size(structure_.row_block[entry]);
    const int64_t first = int64_t{compact_.row_in_panel[entry]} * structure_.block_size(column);
    target.error = sums->error_terms.values.data() + compact_.panel_begin[column] + first +
                   int64_t{c} * height + r;
  }
  return target;
}

void Assembler::AddPart(const EliminationInput& input, const Chunk& chunk, const ChunkSum& sum,
                        size_t i, const PairsOfPart& pairs, CameraSums* sums) const {
  const int part = chunk.parts[i];
  const size_t num_parts = chunk.parts.size();
  const auto prefetch = [&](size_t pair) {
    if (pair < pairs.last) PrefetchPair(part, chunk.parts[chunk.pairs[pair].second], sums);
  };
  for (size_t ahead = 0; ahead < kPairsAhead; ++ahead) prefetch(pairs.first + ahead);
  for (size_t k = 0; k < pairs.num_as_second; ++k) {
    const int pair = pairs.as_second[k];
    AddPair(chunk.parts[chunk.pairs[pair].first], part, sum.BlockOf(num_parts + pair),
            PairSegment::kSecond, sums);
  }
  AddVectors(part, sum.VectorsOf(input, i), sum.SquaresOf(i), Segment::kOwn, sums);
  AddDiagonal(part, sum.BlockOf(i), Segment::kOwn, sums);
  if (!sums->system.camera_diagonal.empty()) {
    AddCameraDiagonal(part, sum.SquaresOf(i), Segment::kOwn, sums);
  }
  for (size_t pair = pairs.first; pair < pairs.last; ++pair) {
    prefetch(pair + kPairsAhead);
    AddPair(part, chunk.parts[chunk.pairs[pair].second], sum.BlockOf(num_parts + pair),
            PairSegment::kFirst, sums);
  }
}

void Assembler::AddSharedBlocks(const EliminationInput& input, const Chunk& chunk,
                                const ChunkSum& sum, CameraSums* sums) const {
  const size_t num_parts = chunk.parts.size();
  const size_t first = own_parts_have_shared_blocks_ ? 0 : chunk.num_own_parts;
  for (size_t i = first; i < num_parts; ++i) {
    const int part = chunk.parts[i];
    AddVectors(part, sum.VectorsOf(input, i), sum.SquaresOf(i), Segment::kShared, sums);
    AddDiagonal(part, sum.BlockOf(i), Segment::kShared, sums);
    if (!sums->system.camera_diagonal.empty()) {
      AddCameraDiagonal(part, sum.SquaresOf(i), Segment::kShared, sums);
    }
  }
  for (size_t pair = chunk.pairs.size(); pair > 0 && chunk.pairs[pair - 1].first >= first; --pair) {
    const Chunk::Pair& of = chunk.pairs[pair - 1];
    AddPair(chunk.parts[of.first], chunk.parts[of.second], sum.BlockOf(num_parts + pair - 1),
            PairSegment::kShared, sums);
  }
}

/// Prefetches the columns of the block to which most of a pair is added. S does not fit the cache,
/// and the columns of a block are far apart.
void Assembler::PrefetchPair(int first, int second, CameraSums* sums) const {
  if (parts_[first].count == 0 || parts_[second].count == 0) return;
  const PartBlock &a = parts_[first].of[0], &b = parts_[second].of[0];
  if (a.block >= b.block) return;
  const int64_t entry = Entry(a.block, b.block);
  for (int i = 0; i < a.size; ++i) {
    const Target column = Block(sums, a.block, entry, 0, i);
    __builtin_prefetch(column.sum, 1);
    __builtin_prefetch(column.sum + b.size - 1, 1);
    if (column.error == nullptr) continue;
    __builtin_prefetch(column.error, 1);
  }
}

void Assembler::AddVectors(int part, const double* vectors, const double* squares, Segment segment,
                           CameraSums* sums) const {
  const int width = WidthOf(part);
  const Target gradient = {sums->gradient.data(), sums->ErrorTermsOf(&sums->error_terms.gradient)};
  const Target rhs = {sums->system.rhs.data(), sums->ErrorTermsOf(&sums->error_terms.rhs)};
  const Target norms = {sums->squared_norms.data(),
                        sums->ErrorTermsOf(&sums->error_terms.squared_norms)};
  for (int s = 0; s < parts_[part].count; ++s) {
    const PartBlock& a = parts_[part].of[s];
    if (a.is_shared != (segment == Segment::kShared)) continue;
    const int offset = structure_.offset[a.block];
    if (a.map != nullptr) {
      double full[kMaxMapped], mapped[kMaxMapped];
      FillLower(squares, parts_[part].num_columns, width, full);
      kernels_.map_block(a, a, full, width, mapped);
      for (int k = 0; k < a.size; ++k) norms.Add(offset + k, mapped[k * (a.size + 1)]);
      for (int i = 0; i < a.num_local; ++i) {
        const double* const at = vectors + a.local[i];
        for (int k = 0; k < a.size; ++k) {
          gradient.Add(offset + k, a.map[i * a.size + k] * at[0]);
          rhs.Add(offset + k, -(a.map[i * a.size + k] * at[width]));
        }
      }
      continue;
    }
    for (int k = 0; k < a.size; ++k) {
      const double* const at = vectors + a.local[k];
      gradient.Add(offset + k, at[0]);
      rhs.Add(offset + k, -at[width]);
      norms.Add(offset + k, at[2 * width]);
    }
  }
}

void Assembler::AddDiagonal(int part, const double* block, Segment segment,
                            CameraSums* sums) const {
  const PartBlocks& blocks = parts_[part];
  for (int s = 0; s < blocks.count; ++s) {
    for (int t = 0; t < blocks.count; ++t) {
      const PartBlock &a = blocks.of[s], &b = blocks.of[t];
      if (a.block > b.block) continue;
      if ((a.is_shared && b.is_shared) != (segment == Segment::kShared)) continue;
      AddDiagonalOf(part, s, t, block, WidthOf(part), sums);
    }
  }
}

/// Only the upper triangle of `block` is defined.
void Assembler::AddDiagonalOf(int part, int s, int t, const double* block, int width,
                              CameraSums* sums) const {
  const PartBlocks& blocks = parts_[part];
  const PartBlock &a = blocks.of[s], &b = blocks.of[t];
  const int64_t entry = Entry(a.block, b.block);
  if (a.map != nullptr || b.map != nullptr) {
    double full[kMaxMapped], mapped[kMaxMapped];
    FillLower(block, blocks.num_columns, width, full);
    kernels_.map_block(a, b, full, width, mapped);
    for (int i = 0; i < a.size; ++i) {
      const Target column = Block(sums, a.block, entry, 0, i);
      for (int j = s == t ? i : 0; j < b.size; ++j) column.Add(j, mapped[i * b.size + j]);
    }
    return;
  }
  for (int i = 0; i < a.size; ++i) {
    const Target column = Block(sums, a.block, entry, 0, i);
    for (int j = s == t ? i : 0; j < b.size; ++j) {
      const auto [first, second] = std::minmax(a.local[i], b.local[j]);
      column.Add(j, block[first * width + second]);
    }
  }
}

void Assembler::AddCameraDiagonal(int part, const double* block, Segment segment,
                                  CameraSums* sums) const {
  const int width = WidthOf(part);
  const Target values = {sums->system.camera_diagonal.data(),
                         sums->ErrorTermsOf(&sums->error_terms.camera_diagonal)};
  for (int s = 0; s < parts_[part].count; ++s) {
    const PartBlock& a = parts_[part].of[s];
    if (a.is_shared != (segment == Segment::kShared)) continue;
    const int64_t begin = diagonal_begin_[a.block];
    if (a.map != nullptr) {
      double full[kMaxMapped], mapped[kMaxMapped];
      FillLower(block, parts_[part].num_columns, width, full);
      kernels_.map_block(a, a, full, width, mapped);
      for (int i = 0; i < a.size; ++i) {
        for (int j = i; j < a.size; ++j) {
          values.Add(begin + i * a.size + j, mapped[i * a.size + j]);
        }
      }
      continue;
    }
    for (int i = 0; i < a.size; ++i) {
      for (int j = i; j < a.size; ++j) {
        values.Add(begin + i * a.size + j, block[a.local[i] * width + a.local[j]]);
      }
    }
  }
}

void Assembler::AddPair(int first, int second, const double* block, PairSegment segment,
                        CameraSums* sums) const {
  const int width = WidthOf(second);
  const bool shared_first = segment != PairSegment::kFirst;
  for (int s = 0; s < parts_[first].count; ++s) {
    for (int t = 0; t < parts_[second].count; ++t) {
      const PartBlock &a = parts_[first].of[s], &b = parts_[second].of[t];
      if (a.is_shared != shared_first) continue;
      if (shared_first && b.is_shared != (segment == PairSegment::kShared)) continue;
      AddBlockOf(first, s, second, t, block, width, sums);
    }
  }
}

void Assembler::AddPairOf(const PartBlock& a, const PartBlock& b, const double* block, int width,
                          CameraSums* sums) const {
  const int64_t entry = Entry(std::min(a.block, b.block), std::max(a.block, b.block));
  if (a.block < b.block && a.is_contiguous && b.is_contiguous) {
    const Target to = Block(sums, a.block, entry, 0, 0);
    kernels_.add_block(block + a.local[0] * width + b.local[0], width, a.size, b.size,
                       {to.sum, structure_.panel_stride[a.block], to.error, b.size});
    return;
  }
  if (a.block > b.block) {
    double transposed[kMaxMapped];
    for (int j = 0; j < b.size; ++j) {
      for (int i = 0; i < a.size; ++i) {
        transposed[j * a.size + i] = block[a.local[i] * width + b.local[j]];
      }
    }
    const Target to = Block(sums, b.block, entry, 0, 0);
    kernels_.add_block(transposed, a.size, b.size, a.size,
                       {to.sum, structure_.panel_stride[b.block], to.error, a.size});
    return;
  }
  for (int i = 0; i < a.size; ++i) {
    const double* const row = block + a.local[i] * width;
    for (int j = 0; j < b.size; ++j) {
      const double value = row[b.local[j]];
      if (a.block < b.block) {
        Block(sums, a.block, entry, j, i).Add(0, value);
        continue;
      }
      // Added to a diagonal block, together with its transpose.
      if (i >= j) Block(sums, a.block, entry, i, j).Add(0, value);
      if (j >= i) Block(sums, a.block, entry, j, i).Add(0, value);
    }
  }
}

}  // namespace bundle
