#pragma once

/// COLMAP models: read, checked, written with refined values.

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/io/colmap_index.h"
#include "core/io/colmap_rigs.h"

namespace bundle {

/// A COLMAP model that was read: its checked files, their contents, and the order of the problem's
/// arrays, which is that of the ids. `WriteColmapModel` writes the files with other numbers: those
/// in memory (`ModelFile`) even if they have changed on the disk.
///
/// Keypoints, points and tracks of the index are freed after the reading. The problem's arrays hold
/// their numbers; all else is read from the files again.
struct ColmapModel {
  ColmapIndex index;
  std::vector<size_t> cameras_by_id;  ///< positions in `index`
  std::vector<size_t> images_by_id;
  /// Per frame of a rig with one camera: the row of its image in the problem's arrays; -1 for a
  /// frame without an image, and for frames of other rigs.
  std::vector<int64_t> image_of_frame;
  ColmapRigs rigs;
  // The arrays of a problem; the caller takes them.
  std::vector<int64_t> point_ids;  ///< ascending
  std::vector<double> points;      ///< three per point
  ColmapObservations observations;

  bool is_binary() const { return index.kind == ModelFile::Kind::kBinary; }
  /// False for older models, without rigs and frames.
  bool has_frames() const { return !index.rigs.empty() || !index.frames.empty(); }
  /// True if a file that is not in memory was written to after the reading began.
  bool has_changed() const {
    return index.rigs_file.has_changed() || index.cameras_file.has_changed() ||
           index.frames_file.has_changed() || index.images_file.has_changed() ||
           index.points_file.has_changed();
  }

  /// (num_images, 7) qx qy qz qw tx ty tz. The pose of an image is that of its frame if the rig has
  /// only one camera; for other rigs, it is that of images.bin.
  std::vector<double> CamFromWorld() const;

  /// Poses in the images file, with the rows of CamFromWorld.
  std::vector<double> ImagePoses() const;
  std::vector<double> RigFromWorld() const;   ///< poses of `rigs.frames`
  std::vector<double> SensorFromRig() const;  ///< poses of `rigs.sensors`
};

/// Reads all files of a COLMAP model. `may_be_empty`: accept a model without
/// cameras or images.
///
/// Throws InputError at the first error, naming file and line (or byte). COLMAP's own reader may
/// accept such a file silently, allocate memory for a corrupt count, or name no position. Also
/// throws for two images of one camera in a frame and for images of a camera whose sensor_from_rig
/// is unknown, which a problem cannot represent.
///
/// Accepts all that COLMAP writes, including unusual valid data: points with one observation or
/// without observations, several keypoints of one image in one track, models without rigs and
/// frames.
ColmapModel ReadColmapModel(const std::string& folder, bool may_be_empty = false);

}  // namespace bundle
