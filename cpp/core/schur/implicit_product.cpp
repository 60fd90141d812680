/// Part of SchurProblem (schur_problem.h): products with S that is not formed, for conjugate
/// gradients. Where points have long tracks in many images, S is full, and forming it takes longer
/// than hundreds of products: a point with L observations adds L^2 / 2 blocks to S, but only L
/// terms to a product. Here the diagonal blocks of S are summed as usual, for the preconditioner,
/// and a product is a pass over the points (kernels/multiply_schur.h).
///
/// Chunks are added in their order, so that the bits do not depend on the number of threads.

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/schur/for_chunks.h"
#include "core/schur/schur_problem.h"

namespace bundle {

void SchurProblem::MultiplySchur(const double* x, double* y) {
  const size_t n = d_squared_.size();
  const int64_t width = input_.part_columns;
  const int num_parts = setup_.parts.num_parts();
  const bool are_kept = input_.kept_records != nullptr;
  if (are_kept) {
    part_steps_.assign(width * num_parts, 0.0);
    for (int part = 0; part < num_parts; ++part) {
      double* const step = part_steps_.data() + width * part;
      assembler_.VisitMaps(part, [&](int l, int k, double m) { step[l] += m * x[k]; });
    }
  } else {
    other_step_.Set({x, x + n}, x_->cameras());
  }
  product_parts_.resize(plan_.chunks.size());
  ForChunks([&](int c, int thread) {
    const Chunk& chunk = plan_.chunks[c];
    product_parts_[c].assign(width * chunk.parts.size(), 0.0);
    if (are_kept) {
      return kernels_.multiply_kept(input_, chunk, part_steps_.data(), Memory(thread),
                                    product_parts_[c].data());
    }
    kernels_.multiply_schur(input_, x_->records(), chunk, damping_, squared_scale_.data(),
                            other_step_.records(), Memory(thread), product_parts_[c].data());
  });
  for (size_t j = 0; j < n; ++j) y[j] = damping_ * d_squared_[j] * x[j];
  const auto add_parts = [&](int first, int last) {
    for (size_t c = 0; c < plan_.chunks.size(); ++c) {
      const std::vector<int>& parts = plan_.chunks[c].parts;
      const auto at = std::lower_bound(parts.begin(), parts.end(), first);
      const double* from = product_parts_[c].data() + width * (at - parts.begin());
      for (auto part = at; part != parts.end() && *part < last; ++part, from += width) {
        assembler_.VisitMaps(*part, [&](int l, int k, double m) { y[k] += m * from[l]; });
      }
    }
  };
  const int64_t alone =
      assembler_.own_parts_have_shared_blocks() ? 0 : setup_.parts.num_own_parts();
  pool_.Run([&](int thread) {
    const int64_t count = pool_.num_threads();
    add_parts(static_cast<int>(alone * thread / count),
              static_cast<int>(alone * (thread + 1) / count));
  });
  add_parts(static_cast<int>(alone), num_parts);
}

/// Keeps the records if they fit the cache. A point in several chunks would have its records
/// written by several threads.
void SchurProblem::KeepRecords() {
  constexpr int64_t kMaxDoubles = (1 << 25) / sizeof(double);
  const int64_t doubles = solver_->NeedsProduct() ? kernels_.kept_doubles(input_) : 0;
  const bool is_spread = std::any_of(plan_.chunks.begin(), plan_.chunks.end(),
                                     [](const Chunk& chunk) { return chunk.last_row > 0; });
  if (doubles == 0 || doubles > kMaxDoubles || is_spread) return;
  kept_records_.resize(doubles + kLine / sizeof(double));
  input_.kept_records = AtCacheLine(kept_records_.data());
}

}  // namespace bundle
