#include "core/sums/point_sections.h"

#include <algorithm>
#include <cstddef>
#include <numeric>

#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

constexpr int kFewestSections = 12;
constexpr int kMostSections = 12 << 6;
// With fewer observations, adding the sums of a chunk takes longer than computing them.
constexpr int64_t kFewestObservations = 16384;

}  // namespace

int NumPointSections(int64_t num_observations) {
  int sections = kFewestSections;
  while (sections < kMostSections && num_observations / (2 * sections) >= kFewestObservations) {
    sections *= 2;
  }
  return sections;
}

LargeVector<uint16_t> FindPointSections(int num_images, int num_points, int64_t num_observations,
                                        const int32_t* observation_image,
                                        const int32_t* observation_point, ThreadPool* pool) {
  const auto count = static_cast<size_t>(num_points);
  // Points that no image sees are last.
  LargeVector<int> first(count, num_images), seen(count, 0);
  LargeVector<int> last(count, -1);
  for (int64_t i = 0; i < num_observations; ++i) {
    const int point = observation_point[i], image = observation_image[i];
    first[point] = std::min(first[point], image);
    last[point] = std::max(last[point], image);
    ++seen[point];
  }
  std::vector<size_t> begin(static_cast<size_t>(num_images) +
                            2);  // begin of the points of each image
  for (const int image : first) ++begin[image + 1];
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  LargeVector<uint64_t> order(count);  // last image and index
  std::vector<size_t> next(begin.begin(), begin.end() - 1);
  for (size_t p = 0; p < count; ++p) {
    order[next[first[p]]++] = static_cast<uint64_t>(last[p] + 1) << 32 | p;
  }
  ForEach(pool, num_images, [&](int64_t i, int) {
    std::sort(order.begin() + static_cast<int64_t>(begin[i]),
              order.begin() + static_cast<int64_t>(begin[i + 1]));
  });
  LargeVector<uint16_t> section(count);
  const int64_t total = num_observations, sections = NumPointSections(total);
  int64_t before = 0;
  for (const uint64_t key : order) {
    const auto point = static_cast<uint32_t>(key);
    // Without this limit, points without observations at the end would get the index of a section
    // that does not exist.
    const int64_t at = total == 0 ? 0 : std::min(before * sections / total, sections - 1);
    section[point] = static_cast<uint16_t>(at);
    before += seen[point];
  }
  return section;
}

}  // namespace bundle
