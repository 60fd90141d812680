#include "core/covariance/point_pairs.h"

#include <cstddef>

namespace bundle {

/// The function below takes a third of the time of all covariances. It is compiled for two
/// generations of processors, and the loader chooses one. Sanitizers cannot be used with this
/// choice, because they start before the loader resolves it.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define BUNDLE_FOR_TWO_PROCESSORS __attribute__((target_clones("avx2", "default")))
#else
#define BUNDLE_FOR_TWO_PROCESSORS
#endif

BUNDLE_FOR_TWO_PROCESSORS
void AddPairs(const ReducedSystem& system, const BlockValues& values, const PointBlocks& blocks,
              const PaddedRows& x, const PaddedRows& z, bool is_same, double sum[9]) {
  const BlockStructure& s = system.structure();
  Four total[3] = {};
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const int j = blocks.blocks[b], columns = s.block_size(j);
    for (size_t a = b; a < blocks.blocks.size(); ++a) {
      const int i = blocks.blocks[a], rows = s.block_size(i);
      const Four* const xi = x.row(blocks.begin[a]);
      const Four* const zi = z.row(blocks.begin[a]);
      const double* block = values.data() + s.ValueIndex(j, s.Entry(j, i), 0, 0);
      for (int c = 0; c < columns; ++c, block += s.panel_stride[j]) {
        // Of a diagonal block, only the lower triangle is read: a column from the diagonal down
        // also gives the row with the same values.
        Four by_x = {}, by_z = {};
        int r = 0;
        if (i == j) {
          by_x = 0.5 * block[c] * xi[c];
          by_z = 0.5 * block[c] * zi[c];
          r = c + 1;
        }
        if (is_same) {
          for (; r < rows; ++r) by_x += block[r] * xi[r];
          by_z = by_x;
        } else {
          for (; r < rows; ++r) {
            by_x += block[r] * xi[r];
            by_z += block[r] * zi[r];
          }
        }
        const Four xj = *x.row(blocks.begin[b] + c), zj = *z.row(blocks.begin[b] + c);
        for (int m = 0; m < 3; ++m) total[m] += by_x[m] * zj + xj[m] * by_z;
      }
    }
  }
  for (int k = 0; k < 9; ++k) sum[k] += total[k / 3][k % 3];
}

}  // namespace bundle
