#pragma once

/// Writing of new COLMAP models, record by record.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "core/io/colmap_index.h"

namespace bundle {

/// A COLMAP model to be written, in the order of COLMAP's files: records by id, but images frame by
/// frame; the reference sensor of a rig first, then its sensors and the data of a frame by type and
/// id. Arrays belong to the caller.
struct ColmapRecords {
  std::vector<ColmapIndex::Camera> cameras;
  std::vector<ColmapIndex::Rig> rigs;
  std::vector<ColmapIndex::Frame> frames;
  std::vector<ColmapIndex::Image> images;     ///< `first_keypoint` is a row of the two arrays below
  const double* keypoint_xy = nullptr;        ///< (num_keypoints, 2), image by image
  const uint64_t* keypoint_points = nullptr;  ///< ids; kInvalidPoint3DId without a point
  size_t num_points = 0;
  const int64_t* point_ids = nullptr;
  const double* points = nullptr;         ///< (num_points, 3)
  const uint8_t* point_colors = nullptr;  ///< (num_points, 3)
  const int64_t* track_lengths = nullptr;
  const int32_t* track_images = nullptr;     ///< positions in `images`, point by point
  const int32_t* track_keypoints = nullptr;  ///< index among the keypoints of the image
};

/// Writes the files of a model into an existing folder, byte for byte as COLMAP 4.2 does. Text has
/// 17 digits.
///
/// The error of a point is computed here, as COLMAP defines it: the mean of ||r|| in pixels along
/// its track, with rotations by the quaternions as they are; sqrt(DBL_MAX) for an observation
/// without a projection and beyond 90 degrees from the optical axis; on a panorama the angle
/// between the rays, in pixels of the equator; -1, "not known", without observations. COLMAP's text
/// reader accepts only finite errors: in text, other errors are written as -1, too. Errors are
/// computed with our projections, so that their last digits differ from COLMAP's.
///
/// `on_block` is called regularly and may throw. Throws std::system_error for errors of the system.
void WriteColmapRecords(const ColmapRecords& records, bool is_binary,
                        const std::filesystem::path& folder, const std::function<void()>& on_block);

/// Parts of the writer that other files use to add rigs and frames to a model without them.
/// `digits`: digits of text, 0 for the shortest number that reads back as the same value.
void WriteColmapRigs(const std::vector<ColmapIndex::Rig>& rigs, bool is_binary, int digits,
                     const std::filesystem::path& folder);
void WriteColmapFrames(const std::vector<ColmapIndex::Frame>& frames, bool is_binary, int digits,
                       const std::filesystem::path& folder);

}  // namespace bundle
