#include "core/covariance/point_pairs.h"

#include <cstddef>

namespace bundle {

/// A third of the time of all covariances.
BUNDLE_FOR_TWO_PROCESSORS
void AddPairs(const ReducedSystem& system, const BlockValues& values, const PointBlocks& blocks,
              const PaddedRows& y, double sum[9]) {
  const BlockStructure& s = system.structure();
  Four total[3] = {};
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const int j = blocks.blocks[b], columns = s.block_size(j);
    for (size_t a = b; a < blocks.blocks.size(); ++a) {
      const int i = blocks.blocks[a], rows = s.block_size(i);
      const Four* const yi = y.row(blocks.begin[a]);
      const double* block = values.data() + s.ValueIndex(j, s.Entry(j, i), 0, 0);
      for (int c = 0; c < columns; ++c, block += s.panel_stride[j]) {
        // Of a diagonal block, only the lower triangle is read: a column from the diagonal down
        // also gives the row with the same values.
        Four by_y = {};
        int r = 0;
        if (i == j) {
          by_y = 0.5 * block[c] * yi[c];
          r = c + 1;
        }
        for (; r < rows; ++r) by_y += block[r] * yi[r];
        const Four yj = *y.row(blocks.begin[b] + c);
        for (int m = 0; m < 3; ++m) total[m] += by_y[m] * yj + yj[m] * by_y;
      }
    }
  }
  for (int k = 0; k < 9; ++k) sum[k] += total[k / 3][k % 3];
}

BUNDLE_FOR_TWO_PROCESSORS
void MultiplyPairs(const ReducedSystem& system, const BlockValues& values,
                   const PointBlocks& blocks, const PaddedRows& y, std::vector<double>* product) {
  const BlockStructure& s = system.structure();
  product->assign(y.values.size(), 0.0);
  Four* const sums = reinterpret_cast<Four*>(product->data());
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const int j = blocks.blocks[b], columns = s.block_size(j);
    for (size_t a = b; a < blocks.blocks.size(); ++a) {
      const int i = blocks.blocks[a], rows = s.block_size(i);
      const Four* const yi = y.row(blocks.begin[a]);
      Four* const to = sums + blocks.begin[a];
      const double* block = values.data() + s.ValueIndex(j, s.Entry(j, i), 0, 0);
      for (int c = 0; c < columns; ++c, block += s.panel_stride[j]) {
        const Four yj = *y.row(blocks.begin[b] + c);
        Four sum = {};
        int r = 0;
        if (i == j) {  // only the lower triangle is read, as above
          sum = block[c] * yj;
          r = c + 1;
        }
        for (; r < rows; ++r) {
          to[r] += block[r] * yj;
          sum += block[r] * yi[r];
        }
        sums[blocks.begin[b] + c] += sum;
      }
    }
  }
}

}  // namespace bundle
