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
                 const BlockStructure& structure, int num_parts)
    : input_(input),
      stride_(input.part_columns),
      column_(stride_ * num_parts, -1),
      scale_(stride_ * num_parts),
      of_column_(structure.num_columns()) {
  for (int i = 0; i < num_parts; ++i) {
    for (int s = 0; s < assembler.num_blocks(i); ++s) {
      const PartBlock& block = assembler.blocks_of(i)[s];
      for (int k = 0; k < block.size; ++k) {
        column_[stride_ * i + block.local[k]] = structure.offset[block.block] + k;
      }
    }
  }
}

void SumGrid::Choose(const std::vector<double>& squared_norms, double cost) {
  for (size_t j = 0; j < of_column_.size(); ++j) {
    of_column_[j] = PowerOfTwoAbove(std::sqrt(squared_norms[j]));
  }
  for (size_t k = 0; k < column_.size(); ++k) {
    scale_[k] = column_[k] < 0 ? 1 : of_column_[column_[k]];
  }
  residual_ = PowerOfTwoAbove(std::sqrt(2 * cost));
  is_chosen_ = true;
}

bool SumGrid::Fits(const std::vector<double>& squared_norms, double cost) const {
  for (size_t j = 0; j < of_column_.size(); ++j) {
    if (!IsWithin(2 * squared_norms[j], of_column_[j])) return false;
  }
  return IsWithin(2 * cost, residual_);
}

void SumGrid::Add(const Chunk& chunk, double sign, ChunkSum* sum) const {
  const double factor = 3 * sign;
  const auto add_block = [&](int first, int second, double* to) {
    const double* const rows = scale_.data() + stride_ * first;
    const double* const columns = scale_.data() + stride_ * second;
    const int width = 4 * input_.part_quads[second];
    for (int a = 0; a < input_.part_rows[first]; ++a, to += width) {
      const double scale = factor * rows[a];
      for (int b = 0; b < width; ++b) to[b] += scale * columns[b];
    }
  };
  const size_t num_parts = chunk.parts.size();
  for (size_t k = 0; k < chunk.pairs.size(); ++k) {
    add_block(chunk.parts[chunk.pairs[k].first], chunk.parts[chunk.pairs[k].second],
              sum->BlockOf(num_parts + k));
  }
  for (size_t i = 0; i < num_parts; ++i) {
    const int part = chunk.parts[i];
    add_block(part, part, sum->BlockOf(i));
    const int width = 4 * input_.part_quads[part];
    const double* const scale = scale_.data() + stride_ * part;
    double* const vectors = sum->VectorsOf(input_, i);
    for (int a = 0; a < width; ++a) {
      vectors[a] += factor * scale[a] * residual_;
      vectors[width + a] += factor * scale[a] * residual_;
      vectors[2 * width + a] += factor * scale[a] * scale[a];
    }
    if (sum->camera_diagonal != nullptr) add_block(part, part, sum->SquaresOf(i));
  }
}

}  // namespace bundle
