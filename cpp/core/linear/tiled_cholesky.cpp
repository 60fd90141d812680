#include "core/linear/tiled_cholesky.h"

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/linear/kernels/panel_kernels.h"
#include "core/parallel/blas.h"
#include "core/parallel/instruction_set.h"

namespace bundle {
namespace {

constexpr int kTile = 384, kRowsOfTask = 192;
/// Beyond this size a tile column of the remaining triangle is read from memory for each tile:
/// fewer passes with wider tiles are faster. Without AVX-512 OpenBLAS, which packs tiles, is faster
/// then.
constexpr int kLargeSystem = 2000, kSmallTile = 96, kLargeTile = 256;

/// Calls visit(number) for 0 to count - 1, on all threads.
template <typename Visit>
void ForTiles(int64_t count, ThreadPool* pool, const Visit& visit) {
  ForEach(pool, count, [&](int64_t number, int /*thread*/) { visit(number); });
}

int FactorizeByOwnKernels(double* a, int n, ThreadPool* pool) {
  const PanelKernels& kernels = SelectPanelKernels();
  const bool is_alone = pool == nullptr || pool->num_threads() == 1;
  // Without tiles, every eight columns read all columns before them.
  if (n < kColumnsWorthTiles || (is_alone && n < kLargeSystem)) {
    return kernels.factorize(a, n, n, n);
  }
  const int tile_size = n < kLargeSystem ? kSmallTile : kLargeTile;
  for (int first = 0; first < n; first += tile_size) {
    ThrowIfInterrupted();
    const int width = std::min(tile_size, n - first), next = first + width;
    double* const tile = a + first + int64_t{first} * n;
    const int failed = kernels.factorize(tile, n, width, width);
    if (failed != 0) return first + failed;
    ForTiles((n - next + kRowsOfTask - 1) / kRowsOfTask, pool, [&](int64_t k) {
      const int row = width + static_cast<int>(k) * kRowsOfTask;
      kernels.solve_rows(tile, n, width, tile + row, std::min(kRowsOfTask, n - first - row));
    });
    // A tile column of the remaining triangle at a time, the tallest first.
    ForTiles((n - next + tile_size - 1) / tile_size, pool, [&](int64_t k) {
      const int column = next + static_cast<int>(k) * tile_size;
      kernels.subtract_product(tile + (column - first), n, n - column,
                               std::min(tile_size, n - column), width,
                               a + column + int64_t{column} * n, n);
    });
  }
  return 0;
}

}  // namespace

bool HasOwnKernels(int n) {
  const InstructionSet set = BestInstructionSet();
  return set == InstructionSet::kAvx512 || (set == InstructionSet::kAvx2 && n < kLargeSystem);
}

void SolveTiled(const double* l, int n, double* x) {
  const PanelKernels& kernels = SelectPanelKernels();
  constexpr int kWidth = 48;
  std::vector<double> below(n);
  for (int first = 0; first < n; first += kWidth) {
    const int width = std::min(kWidth, n - first), height = n - first;
    kernels.forward(l + first + int64_t{first} * n, n, height, width, x + first, below.data());
    for (int i = width; i < height; ++i) x[first + i] -= below[i - width];
  }
  for (int first = (n - 1) / kWidth * kWidth; first >= 0; first -= kWidth) {
    const int width = std::min(kWidth, n - first);
    kernels.backward(l + first + int64_t{first} * n, n, n - first, width, x + first,
                     x + first + width);
  }
}

int FactorizeTiled(double* a, int n, ThreadPool* pool) {
  constexpr char kRight = 'R', kLower = 'L', kTransposed = 'T', kNot = 'N';
  constexpr double kOne = 1, kMinusOne = -1;
  if (HasOwnKernels(n)) return FactorizeByOwnKernels(a, n, pool);
  const int num_tiles = (n + kTile - 1) / kTile;
  const auto tile = [&](int i, int j) { return a + int64_t{i} * kTile + int64_t{j} * kTile * n; };
  const auto size = [&](int i) { return std::min(kTile, n - i * kTile); };
  for (int k = 0; k < num_tiles; ++k) {
    ThrowIfInterrupted();
    const int width = size(k);
    int info = 0;
    dpotrf_(&kLower, &width, tile(k, k), &n, &info);
    if (info != 0) return k * kTile + info;
    const int below = num_tiles - 1 - k;
    ForTiles(below, pool, [&](int64_t number) {
      const int i = k + 1 + static_cast<int>(number), height = size(i);
      dtrsm_(&kRight, &kLower, &kTransposed, &kNot, &height, &width, &kOne, tile(k, k), &n,
             tile(i, k), &n);
    });
    // Column by column of the remaining square. Tiles above its diagonal are skipped.
    ForTiles(int64_t{below} * below, pool, [&](int64_t number) {
      const int i = k + 1 + static_cast<int>(number % below), height = size(i);
      const int j = k + 1 + static_cast<int>(number / below), columns = size(j);
      if (i > j) {
        dgemm_(&kNot, &kTransposed, &height, &columns, &width, &kMinusOne, tile(i, k), &n,
               tile(j, k), &n, &kOne, tile(i, j), &n);
      } else if (i == j) {
        dsyrk_(&kLower, &kNot, &height, &width, &kMinusOne, tile(i, k), &n, &kOne, tile(i, i), &n);
      }
    });
  }
  return 0;
}

}  // namespace bundle
