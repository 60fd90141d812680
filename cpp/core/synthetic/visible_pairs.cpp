#include "core/synthetic/visible_pairs.h"

#include <algorithm>
#include <numeric>
#include <utility>

#include "core/parallel/thread_pool.h"

namespace bundle {

namespace {

constexpr int64_t kImagesAtATime = 64;  // their candidates are stored at the same time
constexpr int64_t kImagesWorthAThread = 8;

std::vector<int64_t> Members(const PointCells& cells, const std::vector<int64_t>& touched) {
  std::vector<int64_t> members;
  for (const int64_t cell : touched) {
    for (int64_t i = cells.starts[cell]; i < cells.starts[cell + 1]; ++i) members.push_back(i);
  }
  return members;
}

std::vector<int64_t> Thin(std::vector<int64_t> members, const double* share, double richness,
                          int64_t fewest, const std::function<double()>& uniform) {
  const auto is_sure = [&](int64_t member) { return share[member] * richness >= 1; };
  if (std::all_of(members.begin(), members.end(), is_sure)) return members;
  std::vector<int64_t> kept;
  for (const int64_t member : members) {
    if (uniform() < share[member] * richness) kept.push_back(member);
  }
  return static_cast<int64_t>(kept.size()) >= fewest ? kept : members;
}

/// Per image: the cells that its ball may touch, ascending.
std::vector<std::vector<int64_t>> FindTouchedCells(const SyntheticImages& images,
                                                   const PointCells& cells, int num_threads) {
  std::vector<std::vector<int64_t>> touched(images.num_images);
  ParallelFor(
      images.num_images, num_threads,
      [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) {
          const double* ball = images.ball_centers + 3 * i;
          const double reach = images.ball_radii[i] + cells.half_diagonal;
          for (int64_t cell = 0; cell < cells.num_cells; ++cell) {
            const double* center = cells.centers + 3 * cell;
            const double x = center[0] - ball[0], y = center[1] - ball[1], z = center[2] - ball[2];
            if (x * x + y * y + z * z <= reach * reach) touched[i].push_back(cell);
          }
        }
      },
      kImagesWorthAThread);
  return touched;
}

/// Per point: the share of its candidates that are kept.
std::vector<double> FindShares(const PointCells& cells,
                               const std::vector<std::vector<int64_t>>& touched,
                               const double* wanted, int64_t num_points) {
  std::vector<int64_t> views(cells.num_cells);
  for (const auto& its_cells : touched) {
    for (const int64_t cell : its_cells) ++views[cell];
  }
  std::vector<double> share(num_points);
  for (int64_t cell = 0; cell < cells.num_cells; ++cell) {
    const auto by = static_cast<double>(std::max<int64_t>(views[cell], 1));
    for (int64_t i = cells.starts[cell]; i < cells.starts[cell + 1]; ++i) share[i] = wanted[i] / by;
  }
  return share;
}

}  // namespace

VisiblePairs FindVisiblePairs(const SyntheticImages& images, const SyntheticPoints& points,
                              const PointCells& cells, const int64_t* order, const double* wanted,
                              int64_t fewest, const std::function<double()>& uniform,
                              int num_threads) {
  const std::vector<std::vector<int64_t>> touched = FindTouchedCells(images, cells, num_threads);
  const std::vector<double> share = FindShares(cells, touched, wanted, points.num_points);
  std::vector<std::vector<int32_t>> seen(images.num_images);
  std::vector<std::vector<int64_t>> candidates(std::min(images.num_images, kImagesAtATime));
  for (int64_t first = 0; first < images.num_images; first += kImagesAtATime) {
    const int64_t count = std::min(kImagesAtATime, images.num_images - first);
    for (int64_t k = 0; k < count; ++k) {
      candidates[k] = Thin(Members(cells, touched[first + k]), share.data(),
                           images.richness[first + k], fewest, uniform);
    }
    ParallelFor(
        count, num_threads,
        [&](int64_t begin, int64_t end) {
          for (int64_t k = begin; k < end; ++k) {
            for (const int64_t i : VisiblePoints(images, first + k, points, candidates[k])) {
              seen[first + k].push_back(static_cast<int32_t>(order[i]));
            }
          }
        },
        kImagesWorthAThread);
  }
  // Sorts pairs from image order to point order, by counting.
  std::vector<int64_t> next(points.num_points + 1);
  for (const auto& its_points : seen) {
    for (const int32_t point : its_points) ++next[point + 1];
  }
  std::partial_sum(next.begin(), next.end(), next.begin());
  VisiblePairs pairs;
  pairs.point.resize(next.back());
  pairs.image.resize(next.back());
  for (int64_t i = 0; i < images.num_images; ++i) {
    for (const int32_t point : seen[i]) {
      pairs.point[next[point]] = point;
      pairs.image[next[point]++] = static_cast<int32_t>(i);
    }
    std::vector<int32_t>().swap(seen[i]);
  }
  return pairs;
}

}  // namespace bundle
