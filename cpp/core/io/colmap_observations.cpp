#include "core/io/colmap_observations.h"

#include <algorithm>

namespace bundle {
namespace {

/// Number of the first row of each point, by position of the point, where rows go by point id.
std::vector<size_t> FirstRows(const std::vector<size_t>& points_by_id,
                              const std::vector<int64_t>& point_of_keypoint) {
  std::vector<size_t> num_rows(points_by_id.size(), 0);
  for (const int64_t point : point_of_keypoint) {
    if (point >= 0) ++num_rows[static_cast<size_t>(point)];
  }
  std::vector<size_t> first_rows(points_by_id.size());
  size_t row = 0;
  for (const size_t point : points_by_id) {
    first_rows[point] = row;
    row += num_rows[point];
  }
  return first_rows;
}

}  // namespace

ColmapObservations SortColmapObservations(const ColmapIndex& index,
                                          const std::vector<int64_t>& point_of_keypoint) {
  const std::vector<size_t> images_by_id = OrderById(index.images);
  const std::vector<size_t> points_by_id = OrderById(index.points);
  std::vector<int32_t> point_rank(points_by_id.size());
  for (size_t rank = 0; rank < points_by_id.size(); ++rank) {
    point_rank[points_by_id[rank]] = static_cast<int32_t>(rank);
  }
  // The coordinates stand in the order of the file, which need not be that of the ids.
  std::vector<size_t> first_xy(index.images.size());
  size_t num_rows = 0;
  for (size_t i = 0; i < index.images.size(); ++i) {
    first_xy[i] = num_rows;
    const auto begin =
        point_of_keypoint.begin() + static_cast<std::ptrdiff_t>(index.images[i].first_keypoint);
    num_rows += static_cast<size_t>(
        std::count_if(begin, begin + static_cast<std::ptrdiff_t>(index.images[i].num_keypoints),
                      [](int64_t point) { return point >= 0; }));
  }

  ColmapObservations result;
  result.image.resize(num_rows);
  result.point.resize(num_rows);
  result.keypoint.resize(num_rows);
  result.xy.resize(2 * num_rows);
  std::vector<size_t> next_row = FirstRows(points_by_id, point_of_keypoint);
  for (size_t rank = 0; rank < images_by_id.size(); ++rank) {
    const ColmapIndex::Image& image = index.images[images_by_id[rank]];
    size_t xy = 2 * first_xy[images_by_id[rank]];
    for (uint64_t k = 0; k < image.num_keypoints; ++k) {
      const int64_t point = point_of_keypoint[image.first_keypoint + k];
      if (point < 0) continue;
      const size_t row = next_row[static_cast<size_t>(point)]++;
      result.image[row] = static_cast<int32_t>(rank);
      result.point[row] = point_rank[static_cast<size_t>(point)];
      result.keypoint[row] = static_cast<int32_t>(k);
      result.xy[2 * row] = index.triangulated_xy[xy++];
      result.xy[2 * row + 1] = index.triangulated_xy[xy++];
    }
  }
  return result;
}

}  // namespace bundle
