#pragma once

/// Survey of a binary COLMAP model, read as a stream, for a division of its points.

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/io/colmap_index.h"
#include "core/io/colmap_model.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// Images that see each point. Images and points are numbered in the order of their ids.
struct ColmapSurvey {
  int64_t num_images = 0;
  int64_t num_observations = 0;
  LargeVector<int64_t> point_ids;    ///< ascending
  LargeVector<int32_t> first_image;  ///< num_points; num_images for a point without a track
  LargeVector<int32_t> last_image;   ///< num_points; -1 for a point without a track
  LargeVector<int32_t> num_seen;     ///< num_points: length of the track
};

/// Reads all files of a model and checks everything except the references between tracks and
/// keypoints, which ReadColmapPart checks. Throws InputError as ReadColmapModel does. `on_block` is
/// called between blocks of about a megabyte and may throw.
ColmapSurvey SurveyColmap(const std::string& folder, const std::function<void()>& on_block);

/// Scans rigs, cameras and frames of a binary model and opens the other two files as streams.
ColmapIndex OpenColmapModel(const std::string& folder, const std::function<void()>& on_block);

/// Orders cameras and images by id and finds the rigs. Throws InputError as ReadColmapModel.
void OrderViews(ColmapModel* model);

/// Per image of the file: its row in the arrays of the problem.
std::vector<int32_t> RowsOfImages(const ColmapModel& model);

}  // namespace bundle
