#include "core/schur/assembly/sum_systems.h"

/// S is the sum over points of what each of them adds (kernels/eliminate_point.h), so that of all
/// ranks is the sum of theirs. Its blocks are sent without what lies between them, a portion of
/// block columns at a time: a copy of a whole S would double the memory that it takes.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace bundle {
namespace {

constexpr const char* kGradient = "gradient";
constexpr size_t kPortion = size_t{1} << 19;  // doubles: 4 MB

/// Calls visit(values of a block's column, their number) for the columns of the blocks in block
/// column j.
template <typename Visit>
void ForBlockColumns(const BlockStructure& structure, int j, double* values, const Visit& visit) {
  for (int64_t e = structure.column_begin[j]; e < structure.column_begin[j + 1]; ++e) {
    const int height = structure.block_size(structure.row_block[e]);
    for (int c = 0; c < structure.block_size(j); ++c) {
      visit(values + structure.ValueIndex(j, e, 0, c), height);
    }
  }
}

/// On rank 0; `rests` nullptr: they are doubles.
void SumToFirst(Reducer* ranks, std::vector<double>* sums, double* rests) {
  constexpr const char* kWhat = "normal equations";
  const auto count = static_cast<int64_t>(sums->size());
  if (count == 0) return;
  if (rests == nullptr) {
    ranks->SumToFirst(kWhat, sums->data(), count);
  } else {
    ranks->SumTwofoldToFirst(kWhat, sums->data(), rests, count);
  }
}

}  // namespace

void SumSystems(Reducer* ranks, const BlockStructure& structure, const Assembler& assembler,
                CameraSums* sums) {
  if (ranks == nullptr) return;
  std::vector<double> portion;
  double* const values = sums->system.values.data();
  for (int first = 0, j = 0; j < structure.num_blocks(); ++j) {
    ForBlockColumns(structure, j, values, [&](const double* column, int height) {
      portion.insert(portion.end(), column, column + height);
    });
    if (portion.size() < kPortion && j + 1 < structure.num_blocks()) continue;
    // Rests have the order of the portion.
    SumToFirst(ranks, &portion,
               sums->has_rests ? &sums->rests.values[assembler.rests_begin(first)] : nullptr);
    const double* from = portion.data();
    for (; first <= j; ++first) {
      if (ranks->rank() != 0) continue;
      ForBlockColumns(structure, first, values, [&](double* column, int height) {
        std::copy_n(from, height, column);
        from += height;
      });
    }
    portion.clear();
  }
  SumToFirst(ranks, &sums->system.rhs, sums->RestsOf(&sums->rests.rhs));
  SumToFirst(ranks, &sums->system.camera_diagonal, sums->RestsOf(&sums->rests.camera_diagonal));
}

void ShareSolution(Reducer* ranks, LinearSolution* solution, std::vector<double>* step) {
  if (ranks == nullptr) return;
  const auto status = BroadcastFirst(ranks, static_cast<double>(solution->status));
  solution->status = static_cast<LinearStatus>(std::lround(status));
  const auto iterations = BroadcastFirst(ranks, static_cast<double>(solution->num_iterations));
  solution->num_iterations = static_cast<int>(std::lround(iterations));
  solution->message = FirstOverRanks(ranks, IsFirst(ranks) ? solution->message : "");
  BroadcastFirst(ranks, "step", step);
}

void SumCameraVectors(Reducer* ranks, CameraSums* sums) {
  if (!sums->has_rests) {
    SumOverRanks(ranks, kGradient, &sums->gradient);
    SumOverRanks(ranks, kGradient, &sums->squared_norms);
    return;
  }
  if (ranks == nullptr || sums->gradient.empty()) return;
  const auto count = static_cast<int64_t>(sums->gradient.size());
  CameraSums::Rests& rests = sums->rests;
  ranks->SumTwofoldToFirst(kGradient, sums->gradient.data(), rests.gradient.data(), count);
  ranks->SumTwofoldToFirst(kGradient, sums->squared_norms.data(), rests.squared_norms.data(),
                           count);
}

void ShareCameraVectors(Reducer* ranks, CameraSums* sums) {
  BroadcastFirst(ranks, kGradient, &sums->gradient);
  BroadcastFirst(ranks, kGradient, &sums->squared_norms);
}

}  // namespace bundle
