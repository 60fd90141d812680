#include "core/linear/tiled_cholesky.h"

#include <algorithm>
#include <atomic>
#include <cstdint>

#include "core/parallel/blas.h"

namespace bundle {
namespace {

constexpr int kLargeTile = 384, kSmallTile = 96;

/// Calls visit(number) for 0 to count - 1, on all threads.
template <typename Visit>
void ForTiles(int64_t count, ThreadPool* pool, const Visit& visit) {
  std::atomic<int64_t> next{0};
  pool->Run([&](int /*thread*/) {
    for (int64_t i = next.fetch_add(1); i < count; i = next.fetch_add(1)) visit(i);
  });
}

}  // namespace

int FactorizeTiled(double* a, int n, ThreadPool* pool) {
  constexpr char kRight = 'R', kLower = 'L', kTransposed = 'T', kNot = 'N';
  constexpr double kOne = 1, kMinusOne = -1;
  const int tile_size = n < kColumnsOfSmallTiles ? kSmallTile : kLargeTile;
  const int num_tiles = (n + tile_size - 1) / tile_size;
  const auto tile = [&](int i, int j) {
    return a + int64_t{i} * tile_size + int64_t{j} * tile_size * n;
  };
  const auto size = [&](int i) { return std::min(tile_size, n - i * tile_size); };
  for (int k = 0; k < num_tiles; ++k) {
    ThrowIfInterrupted();
    const int width = size(k);
    int info = 0;
    dpotrf_(&kLower, &width, tile(k, k), &n, &info);
    if (info != 0) return k * tile_size + info;
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
