#include "core/schur/assembly/assembler.h"

#include <algorithm>

#include "core/sums/double_double.h"

namespace bundle {
namespace {

constexpr size_t kPairsAhead = 6;  // about the number of cache misses that a core handles at once

/// Width of the rows of an image's Jacobian, and of the blocks that have it as second image.
int WidthOf(const EliminationInput& input, int image) {
  return input.mixed ? 4 * input.image_quads[image] : input.num_columns;
}

bool IsSensor(int place) { return place == ParameterLayout::kSensorBlock; }

/// The free columns of K (factors/rig_pose.h), which moves the six numbers of a pose.
void FillSensorMap(const CameraBlock& block, const double whole[kPoseSize * kPoseSize],
                   ColumnMap* map) {
  map->num_columns = kPoseSize;
  double* to = map->values;
  for (int i = 0; i < kPoseSize; ++i) {
    map->columns[i] = static_cast<int8_t>(i);
    for (int k = 0; k < block.size; ++k) *to++ = whole[kPoseSize * i + block.columns[k]];
  }
}

}  // namespace

Assembler::Assembler(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const std::vector<ModelGroup>& groups, const std::vector<uint8_t>& image_group,
                     const BlockStructure& structure)
    : problem_(problem),
      layout_(layout),
      structure_(structure),
      images_(problem.num_images),
      diagonal_begin_(DiagonalBlockOffsets(structure)) {
  for (int i = 0; i < problem.num_images; ++i) {
    const ModelGroup& group = groups[image_group[i]];
    images_[i].num_columns = group.num_columns;
    for (int place = 0; place < static_cast<int>(layout.blocks_of(i).size()); ++place) {
      AddBlock(i, place, group);
    }
  }
  // The addresses of the values do not change from here on.
  for (const MapOf& map : maps_) images_[map.image].of[map.k].map = &map_values_[map.first];
  const auto is_of_sensor = [](const MapOf& map) { return IsSensor(map.place); };
  if (!std::all_of(maps_.begin(), maps_.end(), is_of_sensor)) return;
  image_is_mapped_.resize(problem.num_images);
  for (const MapOf& map : maps_) image_is_mapped_[map.image] = 1;
}

void Assembler::SetMaps(const CameraStates& cameras) {
  for (const MapOf& of : maps_) {
    ColumnMap map;
    const ImageBlock& block = images_[of.image].of[of.k];
    if (IsSensor(of.place)) {
      double whole[kPoseSize * kPoseSize];
      SensorByFrameMap(cameras.rig(of.image), whole);
      FillSensorMap(layout_.blocks()[block.block], whole, &map);
    } else if (of.place == ParameterLayout::kPoseBlock) {
      layout_.FillMap(problem_, of.image, of.place, cameras.pose(of.image), &map);
    } else {
      continue;  // this map is constant
    }
    std::copy_n(map.values, map.num_columns * block.size, &map_values_[of.first]);
  }
}

void Assembler::AddBlock(int image, int place, const ModelGroup& group) {
  const int block = layout_.blocks_of(image)[place];
  if (block < 0) return;
  const CameraBlock& columns = layout_.blocks()[block];
  const int8_t* local = columns.columns;
  ColumnMap map;
  ImageBlock& added = images_[image].of[images_[image].count];
  added.block = block;
  added.size = added.num_local = columns.size;
  added.is_shared = place != ParameterLayout::kPoseBlock;
  has_shared_blocks_ |= added.is_shared;
  if (IsSensor(place) || layout_.HasMap(problem_, image, place)) {
    maps_.push_back({image, place, images_[image].count, map_values_.size()});
    if (IsSensor(place)) {
      constexpr double kUntilSetMaps[kPoseSize * kPoseSize] = {};
      FillSensorMap(columns, kUntilSetMaps, &map);
    } else {
      layout_.FillMap(problem_, image, place, PoseState(), &map);
    }
    map_values_.insert(map_values_.end(), map.values, map.values + map.num_columns * columns.size);
    added.num_local = map.num_columns;
    local = map.columns;
  }
  ++images_[image].count;
  for (int k = 0; k < added.num_local; ++k) {
    const int8_t* const end = group.columns + group.num_columns;
    added.local[k] = static_cast<int8_t>(std::find(group.columns, end, local[k]) - group.columns);
    added.is_contiguous &= added.local[k] == added.local[0] + k;
  }
}

void Assembler::Target::Add(int64_t i, double value) const {
  if (error == nullptr) {
    sum[i] += value;
  } else {
    AddDoubleDouble(value, sum + i, error + i);
  }
}

/// Usually, an image refines all columns that its model refines, and they are contiguous.
void Assembler::AddColumn(const ImageBlock& rows, const double* from, const Target& column) {
  if (!rows.is_contiguous) {
    for (int j = 0; j < rows.size; ++j) column.Add(j, from[rows.local[j]]);
    return;
  }
  from += rows.local[0];
  if (column.error == nullptr) {
    for (int j = 0; j < rows.size; ++j) column.sum[j] += from[j];
  } else {
    for (int j = 0; j < rows.size; ++j) AddDoubleDouble(from[j], column.sum + j, column.error + j);
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

void Assembler::AddImage(const EliminationInput& input, const Chunk& chunk, const ChunkSum& sum,
                         size_t i, const PairsOfImage& pairs, CameraSums* sums) const {
  const int64_t block_size = static_cast<int64_t>(input.num_rows) * input.num_columns;
  const auto slot = static_cast<int64_t>(i);
  const int image = chunk.images[i];
  const auto block = [&](int64_t b) {
    return sum.blocks + (input.mixed ? sum.block_begin[b] : block_size * b);
  };
  const auto prefetch = [&](size_t pair) {
    if (pair < pairs.last) PrefetchPair(image, chunk.images[chunk.pairs[pair].second], sums);
  };
  for (size_t ahead = 0; ahead < kPairsAhead; ++ahead) prefetch(pairs.first + ahead);
  const auto num_images = static_cast<int64_t>(chunk.images.size());
  for (size_t k = 0; k < pairs.num_as_second; ++k) {
    const int pair = pairs.as_second[k];
    AddPair(input, chunk.images[chunk.pairs[pair].first], image, block(num_images + pair),
            PairPart::kSecond, sums);
  }
  const double* const squares =
      sum.camera_diagonal == nullptr ? nullptr : sum.camera_diagonal + block_size * slot;
  AddVectors(input, image, sum.vectors + ChunkSum::kVectors * input.num_columns * slot, squares,
             Part::kOwn, sums);
  AddDiagonal(input, image, block(slot), Part::kOwn, sums);
  if (!sums->system.camera_diagonal.empty()) {
    AddCameraDiagonal(input, image, sum.camera_diagonal + block_size * slot, Part::kOwn, sums);
  }
  for (size_t pair = pairs.first; pair < pairs.last; ++pair) {
    prefetch(pair + kPairsAhead);
    AddPair(input, image, chunk.images[chunk.pairs[pair].second],
            block(num_images + static_cast<int64_t>(pair)), PairPart::kFirst, sums);
  }
}

void Assembler::AddSharedBlocks(const EliminationInput& input, const Chunk& chunk,
                                const ChunkSum& sum, CameraSums* sums) const {
  const int64_t block_size = static_cast<int64_t>(input.num_rows) * input.num_columns;
  const auto block = [&](int64_t b) {
    return sum.blocks + (input.mixed ? sum.block_begin[b] : block_size * b);
  };
  const size_t num_images = chunk.images.size();
  size_t pair = 0;
  for (size_t i = 0; i < num_images; ++i) {
    const int image = chunk.images[i];
    const auto slot = static_cast<int64_t>(i);
    const double* const squares =
        sum.camera_diagonal == nullptr ? nullptr : sum.camera_diagonal + block_size * slot;
    AddVectors(input, image, sum.vectors + ChunkSum::kVectors * input.num_columns * slot, squares,
               Part::kShared, sums);
    AddDiagonal(input, image, block(slot), Part::kShared, sums);
    if (!sums->system.camera_diagonal.empty()) {
      AddCameraDiagonal(input, image, squares, Part::kShared, sums);
    }
    for (; pair < chunk.pairs.size() && chunk.pairs[pair].first == i; ++pair) {
      AddPair(input, image, chunk.images[chunk.pairs[pair].second],
              block(static_cast<int64_t>(num_images + pair)), PairPart::kShared, sums);
    }
  }
}

/// Prefetches the columns of the block to which most of a pair is added. S does not fit the cache,
/// and the columns of a block are far apart.
void Assembler::PrefetchPair(int first, int second, CameraSums* sums) const {
  if (images_[first].count == 0 || images_[second].count == 0) return;
  const ImageBlock &a = images_[first].of[0], &b = images_[second].of[0];
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

void Assembler::AddVectors(const EliminationInput& input, int image, const double* vectors,
                           const double* squares, Part part, CameraSums* sums) const {
  const int width = WidthOf(input, image);
  const Target gradient = {sums->gradient.data(), sums->ErrorTermsOf(&sums->error_terms.gradient)};
  const Target rhs = {sums->system.rhs.data(), sums->ErrorTermsOf(&sums->error_terms.rhs)};
  const Target norms = {sums->squared_norms.data(),
                        sums->ErrorTermsOf(&sums->error_terms.squared_norms)};
  for (int s = 0; s < images_[image].count; ++s) {
    const ImageBlock& a = images_[image].of[s];
    if (a.is_shared != (part == Part::kShared)) continue;
    const int offset = structure_.offset[a.block];
    if (a.map != nullptr) {
      double full[kMaxMapped], mapped[kMaxMapped];
      FillLower(squares, images_[image].num_columns, width, full);
      MapBlock(a, a, full, width, mapped);
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

/// Only the upper triangle of `block` is defined.
void Assembler::AddDiagonal(const EliminationInput& input, int image, const double* block,
                            Part part, CameraSums* sums) const {
  const ImageBlocks& blocks = images_[image];
  const int width = WidthOf(input, image);
  for (int s = 0; s < blocks.count; ++s) {
    for (int t = 0; t < blocks.count; ++t) {
      const ImageBlock &a = blocks.of[s], &b = blocks.of[t];
      if (a.block > b.block) continue;
      if ((a.is_shared && b.is_shared) != (part == Part::kShared)) continue;
      const int64_t entry = Entry(a.block, b.block);
      if (a.map != nullptr || b.map != nullptr) {
        double full[kMaxMapped], mapped[kMaxMapped];
        FillLower(block, blocks.num_columns, width, full);
        MapBlock(a, b, full, width, mapped);
        for (int i = 0; i < a.size; ++i) {
          const Target column = Block(sums, a.block, entry, 0, i);
          for (int j = s == t ? i : 0; j < b.size; ++j) column.Add(j, mapped[i * b.size + j]);
        }
        continue;
      }
      for (int i = 0; i < a.size; ++i) {
        const Target column = Block(sums, a.block, entry, 0, i);
        for (int j = s == t ? i : 0; j < b.size; ++j) {
          const auto [first, second] = std::minmax(a.local[i], b.local[j]);
          column.Add(j, block[first * width + second]);
        }
      }
    }
  }
}

void Assembler::AddCameraDiagonal(const EliminationInput& input, int image, const double* block,
                                  Part part, CameraSums* sums) const {
  const int width = WidthOf(input, image);
  const Target values = {sums->system.camera_diagonal.data(),
                         sums->ErrorTermsOf(&sums->error_terms.camera_diagonal)};
  for (int s = 0; s < images_[image].count; ++s) {
    const ImageBlock& a = images_[image].of[s];
    if (a.is_shared != (part == Part::kShared)) continue;
    const int64_t begin = diagonal_begin_[a.block];
    if (a.map != nullptr) {
      double full[kMaxMapped], mapped[kMaxMapped];
      FillLower(block, images_[image].num_columns, width, full);
      MapBlock(a, a, full, width, mapped);
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

void Assembler::AddPair(const EliminationInput& input, int first, int second, const double* block,
                        PairPart part, CameraSums* sums) const {
  const int width = WidthOf(input, second);
  const bool shared_first = part != PairPart::kFirst;
  for (int s = 0; s < images_[first].count; ++s) {
    for (int t = 0; t < images_[second].count; ++t) {
      const ImageBlock &a = images_[first].of[s], &b = images_[second].of[t];
      if (a.is_shared != shared_first) continue;
      if (shared_first && b.is_shared != (part == PairPart::kShared)) continue;
      if (a.map != nullptr || b.map != nullptr) {
        double mapped[kMaxMapped];
        MapBlock(a, b, block, width, mapped);
        AddPairOf(a.WithoutMap(), b.WithoutMap(), mapped, b.size, sums);
      } else {
        AddPairOf(a, b, block, width, sums);
      }
    }
  }
}

void Assembler::AddPairOf(const ImageBlock& a, const ImageBlock& b, const double* block, int width,
                          CameraSums* sums) const {
  const int64_t entry = Entry(std::min(a.block, b.block), std::max(a.block, b.block));
  for (int i = 0; i < a.size; ++i) {
    const double* const row = block + a.local[i] * width;
    if (a.block < b.block) {
      AddColumn(b, row, Block(sums, a.block, entry, 0, i));
      continue;
    }
    for (int j = 0; j < b.size; ++j) {
      const double value = row[b.local[j]];
      if (a.block > b.block) {
        Block(sums, b.block, entry, i, j).Add(0, value);
        continue;
      }
      // Added to a diagonal block, together with its transpose.
      if (i >= j) Block(sums, a.block, entry, i, j).Add(0, value);
      if (j >= i) Block(sums, a.block, entry, j, i).Add(0, value);
    }
  }
}

}  // namespace bundle
