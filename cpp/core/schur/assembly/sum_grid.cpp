#include "core/schur/assembly/sum_grid.h"

#include <cmath>

namespace bundle {
namespace {

// s_a is between kRoom and 2 kRoom times ||J e_a||. kRoom is not a power of two: a norm of exactly
// 1 (columns whose entries are all 1, for instance) must not be at a boundary where rounding
// decides on the exponent.
constexpr double kRoom = 2.7;

// Products of two larger norms would leave the range of doubles. Columns with larger norms use no
// grid.
constexpr double kLargest = 1e120, kSmallest = 1e-120;

double PowerOfTwoAbove(double norm) {
  if (!(norm > kSmallest && norm < kLargest)) return 0;
  int exponent = 0;
  std::frexp(kRoom * norm, &exponent);
  return std::ldexp(1.0, exponent);
}

bool IsWithin(double squared, double bound) {
  if (squared <= bound * bound) return true;
  const double norm = std::sqrt(squared);
  return bound == 0 ? PowerOfTwoAbove(norm) == 0 : !std::isfinite(norm);
}

}  // namespace

SumGrid::SumGrid(const EliminationInput& input, const Assembler& assembler,
                 const BlockStructure& structure, int num_images)
    : input_(input),
      stride_(input.num_columns),
      column_(stride_ * num_images, -1),
      scale_(stride_ * num_images),
      of_column_(structure.num_columns()) {
  for (int i = 0; i < num_images; ++i) {
    for (int s = 0; s < assembler.num_blocks(i); ++s) {
      const ImageBlock& block = assembler.blocks_of(i)[s];
      for (int k = 0; k < block.size; ++k) {
        column_[stride_ * i + block.local[k]] = structure.offset[block.block] + k;
      }
    }
  }
}

int SumGrid::WidthOf(int image) const {
  return input_.mixed ? 4 * input_.image_quads[image] : input_.num_columns;
}

void SumGrid::Choose(const std::vector<double>& squared_norms, double cost) {
  for (size_t j = 0; j < of_column_.size(); ++j) {
    of_column_[j] = PowerOfTwoAbove(std::sqrt(squared_norms[j]));
  }
  for (size_t k = 0; k < column_.size(); ++k) {
    scale_[k] = column_[k] < 0 ? 0 : of_column_[column_[k]];
  }
  residual_ = PowerOfTwoAbove(std::sqrt(2 * cost));
  is_chosen_ = true;
}

bool SumGrid::Fits(const std::vector<double>& squared_norms, double cost) const {
  for (size_t j = 0; j < of_column_.size(); ++j) {
    if (!IsWithin(squared_norms[j], of_column_[j])) return false;
  }
  return IsWithin(2 * cost, residual_);
}

void SumGrid::Add(const Chunk& chunk, double sign, ChunkSum* sum) const {
  const double factor = 3 * sign;
  const int64_t block_size = static_cast<int64_t>(input_.num_rows) * input_.num_columns;
  const auto add_block = [&](int first, int second, double* to) {
    const double* const rows = scale_.data() + stride_ * first;
    const double* const columns = scale_.data() + stride_ * second;
    const int width = WidthOf(second);
    for (int a = 0; a < input_.image_columns[first]; ++a, to += width) {
      const double scale = factor * rows[a];
      for (int b = 0; b < width; ++b) to[b] += scale * columns[b];
    }
  };
  int64_t number = 0;
  const auto next_block = [&] {
    const int64_t b = number++;
    return sum->blocks + (input_.mixed ? sum->block_begin[b] : block_size * b);
  };
  for (const int image : chunk.images) add_block(image, image, next_block());
  for (const Chunk::Pair& pair : chunk.pairs) {
    add_block(chunk.images[pair.first], chunk.images[pair.second], next_block());
  }
  for (size_t i = 0; i < chunk.images.size(); ++i) {
    const int image = chunk.images[i];
    const int width = WidthOf(image);
    const double* const scale = scale_.data() + stride_ * image;
    double* const vectors = sum->vectors + ChunkSum::kVectors * stride_ * i;
    for (int a = 0; a < width; ++a) {
      vectors[a] += factor * scale[a] * residual_;
      vectors[width + a] += factor * scale[a] * residual_;
      vectors[2 * width + a] += factor * scale[a] * scale[a];
    }
    if (sum->camera_diagonal == nullptr) continue;
    add_block(image, image, sum->camera_diagonal + block_size * static_cast<int64_t>(i));
  }
}

}  // namespace bundle
