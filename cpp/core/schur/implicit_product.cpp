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
  other_step_.Set({x, x + n}, x_->cameras());
  product_parts_.resize(plan_.chunks.size());
  ForChunks([&](int c, int thread) {
    const Chunk& chunk = plan_.chunks[c];
    product_parts_[c].assign(width * chunk.parts.size(), 0.0);
    kernels_.multiply_schur(input_, x_->records(), chunk, damping_, squared_scale_.data(),
                            other_step_.records(), Memory(thread), product_parts_[c].data());
  });
  for (size_t j = 0; j < n; ++j) y[j] = damping_ * d_squared_[j] * x[j];
  for (size_t c = 0; c < plan_.chunks.size(); ++c) {
    const double* from = product_parts_[c].data();
    for (const int part : plan_.chunks[c].parts) {
      assembler_.AddVector(part, from, y);
      from += width;
    }
  }
}

}  // namespace bundle
