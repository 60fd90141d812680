#pragma once

/// Parts of binary COLMAP models, read as streams: nothing is kept but cameras, images and what a
/// part has.

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/io/colmap_model.h"

namespace bundle {

/// What tells which points belong together. Images and points are counted in the order of their
/// ids.
struct ColmapSurvey {
  int64_t num_images = 0;
  int64_t num_observations = 0;
  std::vector<int64_t> point_ids;    ///< ascending
  std::vector<int32_t> first_image;  ///< num_points; num_images for a point without a track
  std::vector<int32_t> last_image;   ///< num_points; -1 for a point without a track
  std::vector<int32_t> num_seen;     ///< num_points: length of the track
};

/// Reads all files of a model and checks all but what needs tracks and keypoints side by side,
/// which is for ReadColmapPart. Throws InputError as ReadColmapModel does. `on_block` is called
/// between blocks of about a megabyte and may throw.
ColmapSurvey SurveyColmap(const std::string& folder, const std::function<void()>& on_block);

struct ColmapPart {
  /// The first contradiction of tracks and keypoints that the part has.
  struct Failure {
    bool is_in_images;  ///< else in points3D.bin, of which ReadColmapModel speaks first
    uint64_t position;
    std::string message;
  };
  ColmapModel model;           ///< cameras, images, rigs and the open files; no points
  std::vector<double> points;  ///< three of each point with a place
  ColmapObservations observations;
  std::optional<Failure> failure;
};

/// Reads cameras, images, the points that have a place (-1: none) and their observations, sorted as
/// ReadColmapModel does. `point_ids` are those of the survey; places ascend with them from 0 on.
/// Throws InputError where the files have other points.
ColmapPart ReadColmapPart(const std::string& folder, const std::vector<int64_t>& point_ids,
                          const std::vector<int32_t>& place, const std::function<void()>& on_block);

/// Scans rigs, cameras and frames of a binary model and opens the other two files as streams.
ColmapIndex OpenColmapModel(const std::string& folder, const std::function<void()>& on_block);

/// Orders cameras and images by id and finds the rigs. Throws InputError as ReadColmapModel.
void OrderViews(ColmapModel* model);

/// Of each image of the file its row in our arrays.
std::vector<int32_t> RowsOfImages(const ColmapModel& model);

}  // namespace bundle
