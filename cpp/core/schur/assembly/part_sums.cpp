#include "core/schur/assembly/part_sums.h"

#include <algorithm>
#include <atomic>
#include <numeric>

namespace bundle {
namespace {

BlockStructure StructureOfParts(const ImageParts& parts, const EliminationPlan& plan) {
  std::vector<std::vector<int>> columns(parts.num_parts());
  for (const Chunk& chunk : plan.chunks) {
    for (const Chunk::Pair& pair : chunk.pairs) {
      columns[chunk.parts[pair.first]].push_back(chunk.parts[pair.second]);
    }
  }
  std::vector<int> sizes;
  for (int p = 0; p < parts.num_parts(); ++p) {
    std::vector<int>& rows = columns[p];
    rows.push_back(p);
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    sizes.push_back(parts.part(p).num_columns);
  }
  return SparseStructure(sizes, columns);
}

}  // namespace

PartSums::PartSums(const AdjustmentProblem& problem, const ParameterLayout& layout,
                   const ImageParts& parts, const Kernels& kernels, const EliminationPlan& plan,
                   const BlockStructure& structure, const Assembler& to_layout,
                   bool has_error_terms)
    : parts_(parts),
      of_layout_(structure),
      to_layout_(to_layout),
      structure_(StructureOfParts(parts, plan)),
      assembler_(problem, layout, parts, kernels, structure_, /*by_parts=*/true) {
  if (has_error_terms) assembler_.PlaceErrorTerms();
  term_begin_.assign(of_layout_.num_blocks() + 1, 0);
  ForTerms([&](int column, const Term& /*term*/) { ++term_begin_[column + 1]; });
  std::partial_sum(term_begin_.begin(), term_begin_.end(), term_begin_.begin());
  terms_.resize(term_begin_.back());
  std::vector<int64_t> next(term_begin_.begin(), term_begin_.end() - 1);
  ForTerms([&](int column, const Term& term) { terms_[next[column]++] = term; });
}

/// Calls visit(block column of S, term) for all terms.
template <typename Visit>
void PartSums::ForTerms(const Visit& visit) const {
  for (int first = 0; first < structure_.num_blocks(); ++first) {
    for (int64_t e = structure_.column_begin[first]; e < structure_.column_begin[first + 1]; ++e) {
      const int second = structure_.row_block[e];
      for (int s = 0; s < to_layout_.num_blocks(first); ++s) {
        for (int t = 0; t < to_layout_.num_blocks(second); ++t) {
          const int a = to_layout_.blocks_of(first)[s].block;
          const int b = to_layout_.blocks_of(second)[t].block;
          if (first == second && a > b) continue;
          visit(std::min(a, b),
                Term{first, second, static_cast<int8_t>(s), static_cast<int8_t>(t), e});
        }
      }
    }
  }
}

void PartSums::Map(const CameraSums& from, bool wants_camera_diagonal, ThreadPool* pool,
                   CameraSums* to) const {
  const auto n = static_cast<size_t>(of_layout_.num_columns());
  to->system.values.resize(of_layout_.num_values);
  to->system.rhs.assign(n, 0.0);
  to->gradient.assign(n, 0.0);
  to->squared_norms.assign(n, 0.0);
  if (wants_camera_diagonal) {
    to->system.camera_diagonal.assign(to_layout_.diagonal_begin().back(), 0.0);
  }
  MapVectors(from, to);
  const int64_t size = of_layout_.num_values, threads = pool->num_threads();
  pool->Run([&](int thread) {
    std::fill(to->system.values.data() + size * thread / threads,
              to->system.values.data() + size * (thread + 1) / threads, 0.0);
  });
  std::atomic<int> next{0};
  pool->Run([&](int /*thread*/) {
    for (int j = next.fetch_add(1); j < of_layout_.num_blocks(); j = next.fetch_add(1)) {
      for (int64_t k = term_begin_[j]; k < term_begin_[j + 1]; ++k) {
        MapTerm(from.system.values, terms_[k], to);
      }
    }
  });
}

/// Column c of the block of (second, first) is row c of that of (first, second).
void PartSums::MapTerm(const BlockValues& values, const Term& term, CameraSums* to) const {
  const int stride = structure_.panel_stride[term.first];
  const double* const block = &values[structure_.ValueIndex(term.first, term.entry, 0, 0)];
  if (term.first != term.second) {
    to_layout_.AddBlockOf(term.first, term.s, term.second, term.t, block, stride, to);
    return;
  }
  double upper[kMaxMapped];
  const int size = structure_.block_size(term.first);
  for (int i = 0; i < size; ++i) {
    std::copy(block + i * stride + i, block + i * stride + size, upper + i * size + i);
  }
  to_layout_.AddBlockOf(term.first, term.s, term.second, term.t, upper, size, to);
}

void PartSums::MapVectors(const CameraSums& from, CameraSums* to) const {
  for (int p = 0; p < structure_.num_blocks(); ++p) {
    const int size = structure_.block_size(p), width = 4 * parts_.part(p).num_quads;
    const int first = structure_.offset[p];
    double vectors[3 * kMaxMapColumns] = {}, squares[kMaxMapped] = {};
    const double* const diagonal =
        from.system.camera_diagonal.data() + assembler_.diagonal_begin()[p];
    for (int k = 0; k < size; ++k) {
      vectors[k] = from.gradient[first + k];
      vectors[width + k] = -from.system.rhs[first + k];
      vectors[2 * width + k] = from.squared_norms[first + k];
      std::copy_n(diagonal + k * size, size, squares + k * width);
    }
    to_layout_.AddVectorsOf(p, vectors, squares, to);
  }
}

void Assembler::AddVectorsOf(int part, const double* vectors, const double* squares,
                             CameraSums* sums) const {
  for (const Segment segment : {Segment::kOwn, Segment::kShared}) {
    AddVectors(part, vectors, squares, segment, sums);
    if (sums->system.camera_diagonal.empty()) continue;
    AddCameraDiagonal(part, squares, segment, sums);
  }
}

void Assembler::AddBlockOf(int first, int s, int second, int t, const double* block, int width,
                           CameraSums* sums) const {
  if (first == second) {
    AddDiagonalOf(first, s, t, block, width, sums);
    return;
  }
  const PartBlock &a = parts_[first].of[s], &b = parts_[second].of[t];
  if (a.map == nullptr && b.map == nullptr) {
    AddPairOf(a, b, block, width, sums);
    return;
  }
  double mapped[kMaxMapped];
  kernels_.map_block(a, b, block, width, mapped);
  AddPairOf(a.WithoutMap(), b.WithoutMap(), mapped, b.size, sums);
}

}  // namespace bundle
