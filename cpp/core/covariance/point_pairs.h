#pragma once

/// Sums over the pairs of a point's blocks: A Y and Y^T A Y for a matrix A with the structure of S.

#include <cstddef>
#include <vector>

#include "core/covariance/point_blocks.h"
#include "core/covariance/reduced_system.h"

/// A function with this attribute is compiled for two generations of processors; the loader chooses
/// one. Sanitizers cannot be used with this choice, because they start before the loader resolves
/// it.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define BUNDLE_FOR_TWO_PROCESSORS __attribute__((target_clones("avx2", "default")))
#else
#define BUNDLE_FOR_TWO_PROCESSORS
#endif

namespace bundle {

/// Four numbers in one register, loaded without alignment.
using Four = double __attribute__((vector_size(32), aligned(8)));

/// Y of a point, four numbers per row, the last one zero.
struct PaddedRows {
  std::vector<double> values;

  void Set(const std::vector<double>& rows) {
    values.resize(rows.size() / 3 * 4);
    for (size_t i = 0; i < rows.size() / 3; ++i) {
      for (int k = 0; k < 3; ++k) values[4 * i + k] = rows[3 * i + k];
      values[4 * i + 3] = 0;
    }
  }
  const Four* row(int i) const { return reinterpret_cast<const Four*>(&values[4 * size_t(i)]); }
};

/// sum += Y^T A Y, 3 x 3 row-major, for a symmetric A.
void AddPairs(const ReducedSystem& system, const BlockValues& values, const PointBlocks& blocks,
              const PaddedRows& y, double sum[9]);

/// A Y, padded as Y, for a symmetric A.
void MultiplyPairs(const ReducedSystem& system, const BlockValues& values,
                   const PointBlocks& blocks, const PaddedRows& y, std::vector<double>* product);

}  // namespace bundle
