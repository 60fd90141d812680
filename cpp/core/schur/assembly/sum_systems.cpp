#include "core/schur/assembly/sum_systems.h"

/// S is a sum over points (kernels/eliminate_point.h), and therefore the sum of the S of all ranks.
/// Blocks are sent without the room for fill-in between them. A portion of block columns is sent at
/// a time, because a copy of S would double its memory.

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

/// Sums to rank 0. `error_terms` is nullptr for plain doubles.
void SumToFirst(Communicator* communicator, std::vector<double>* sums, double* error_terms) {
  constexpr const char* kWhat = "normal equations";
  const auto count = static_cast<int64_t>(sums->size());
  if (count == 0) return;
  if (error_terms == nullptr) {
    communicator->SumToFirst(kWhat, sums->data(), count);
  } else {
    communicator->SumDoubleDoubleToFirst(kWhat, sums->data(), error_terms, count);
  }
}

}  // namespace

void SumSystems(Communicator* communicator, const BlockStructure& structure,
                const Assembler& assembler, CameraSums* sums) {
  if (communicator == nullptr) return;
  std::vector<double> portion;
  double* const values = sums->system.values.data();
  for (int first = 0, j = 0; j < structure.num_blocks(); ++j) {
    ForBlockColumns(structure, j, values, [&](const double* column, int height) {
      portion.insert(portion.end(), column, column + height);
    });
    if (portion.size() < kPortion && j + 1 < structure.num_blocks()) continue;
    // Error terms are stored in the order of the portion.
    SumToFirst(communicator, &portion,
               sums->has_error_terms ? &sums->error_terms.values[assembler.error_terms_begin(first)]
                                     : nullptr);
    const double* from = portion.data();
    for (; first <= j; ++first) {
      if (communicator->rank() != 0) continue;
      ForBlockColumns(structure, first, values, [&](double* column, int height) {
        std::copy_n(from, height, column);
        from += height;
      });
    }
    portion.clear();
  }
  SumToFirst(communicator, &sums->system.rhs, sums->ErrorTermsOf(&sums->error_terms.rhs));
  SumToFirst(communicator, &sums->system.camera_diagonal,
             sums->ErrorTermsOf(&sums->error_terms.camera_diagonal));
}

void BroadcastSolution(Communicator* communicator, LinearSolution* solution,
                       std::vector<double>* step) {
  if (communicator == nullptr) return;
  const auto status = BroadcastFirst(communicator, static_cast<double>(solution->status));
  solution->status = static_cast<LinearStatus>(std::lround(status));
  const auto iterations =
      BroadcastFirst(communicator, static_cast<double>(solution->num_iterations));
  solution->num_iterations = static_cast<int>(std::lround(iterations));
  solution->message = FirstOverRanks(communicator, IsFirst(communicator) ? solution->message : "");
  BroadcastFirst(communicator, "step", step);
}

void SumCameraVectors(Communicator* communicator, CameraSums* sums) {
  if (!sums->has_error_terms) {
    SumOverRanks(communicator, kGradient, &sums->gradient);
    SumOverRanks(communicator, kGradient, &sums->squared_norms);
    return;
  }
  if (communicator == nullptr || sums->gradient.empty()) return;
  const auto count = static_cast<int64_t>(sums->gradient.size());
  CameraSums::ErrorTerms& error_terms = sums->error_terms;
  communicator->SumDoubleDoubleToFirst(kGradient, sums->gradient.data(),
                                       error_terms.gradient.data(), count);
  communicator->SumDoubleDoubleToFirst(kGradient, sums->squared_norms.data(),
                                       error_terms.squared_norms.data(), count);
}

void BroadcastCameraVectors(Communicator* communicator, CameraSums* sums) {
  BroadcastFirst(communicator, kGradient, &sums->gradient);
  BroadcastFirst(communicator, kGradient, &sums->squared_norms);
}

}  // namespace bundle
