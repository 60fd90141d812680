#pragma once

/// COLMAP models: read, checked, written with refined values.

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/io/colmap_index.h"

namespace bundle {

/// Rigs that are more than a reference camera, as our problem has them: frames with an image by id,
/// cameras with a sensor_from_rig by the ids of rig and camera. All empty where no such rig has a
/// frame with an image. Other sensors (IMUs, cameras of unknown pose) stay in the files.
struct ColmapRigs {
  struct Place {
    size_t rig;     ///< in index.rigs
    size_t sensor;  ///< in its sensors
  };
  std::vector<size_t> frames;  ///< positions in index.frames
  std::vector<Place> sensors;
  std::vector<int32_t> image_frame;   ///< of each row of our images: row in `frames`; -1: none
  std::vector<int32_t> image_sensor;  ///< row in `sensors`; -1: the reference sensor, or no frame
};

/// A COLMAP model as it was read: its files, checked, what stands in them, and the order of our
/// arrays, which is that of the ids. The files stay in memory, so that `WriteColmapModel` can write
/// them again with other numbers whatever has become of them on the disk.
struct ColmapModel {
  ColmapIndex index;
  std::vector<size_t> cameras_by_id;  ///< positions in `index`
  std::vector<size_t> images_by_id;
  std::vector<size_t> points_by_id;
  /// Of each frame of a rig of one camera, the row of its image in our arrays; -1 for one without
  /// an image, and for frames of other rigs.
  std::vector<int64_t> image_of_frame;
  ColmapRigs rigs;
  ColmapObservations observations;

  bool is_binary() const { return index.kind == ModelFile::Kind::kBinary; }
  /// Models from before there were rigs and frames have neither.
  bool has_frames() const { return !index.rigs.empty() || !index.frames.empty(); }

  /// (num_images, 7) qx qy qz qw tx ty tz. The pose of an image is its frame's where its frame has
  /// but one camera, and that of images.bin in frames of other rigs.
  std::vector<double> CamFromWorld() const;

  /// As the images file has them, rows as those of CamFromWorld.
  std::vector<double> ImagePoses() const;
  std::vector<double> RigFromWorld() const;   ///< of `rigs.frames`
  std::vector<double> SensorFromRig() const;  ///< of `rigs.sensors`
};

/// Reads the files of a COLMAP model from end to end, and keeps them. `may_be_empty`: accept a
/// model without cameras or images.
///
/// Throws InputError at the first error, naming file and line (or byte). COLMAP's own reader may
/// accept such a file silently, allocate what a corrupt count says, or name no place. Also throws
/// for two images of one camera in a frame and for images of a camera whose sensor_from_rig is not
/// known, which a problem cannot represent.
///
/// Everything that COLMAP writes is accepted, and so is unusual valid data: points with one
/// observation or none, several keypoints of one image in one track, models without rigs and
/// frames.
ColmapModel ReadColmapModel(const std::string& folder, bool may_be_empty = false);

/// The scan alone, without the check of references; binary files where the folder holds both
/// formats, as COLMAP.
ColmapIndex ScanColmapModel(const std::string& folder);

/// Fills `image_of_frame` and `rigs` from the index and its order. Throws InputError as
/// ReadColmapModel does.
void FindColmapRigs(ColmapModel* model);

/// The numbers that a solve changes, one row a record in the order of the ids.
struct ColmapValues {
  const double* cam_from_world = nullptr;   ///< (num_images, 7) qx qy qz qw tx ty tz
  const double* rig_from_world = nullptr;   ///< (frames of ColmapRigs, 7)
  const double* sensor_from_rig = nullptr;  ///< (sensors of ColmapRigs, 7)
  const double* camera_params = nullptr;    ///< (num_cameras, params_width)
  size_t params_width = 0;
  const double* points = nullptr;        ///< (num_points, 3)
  const double* point_errors = nullptr;  ///< (num_points,) mean reprojection error in pixels
};

/// Writes the files of a model into an existing folder, in the format in which it was read.
///
/// Every byte but the given numbers is that of the files that were read: keypoints, tracks,
/// colours, rigs, comments. A model from before there were rigs and frames gets them as COLMAP
/// makes them: a rig a camera and a frame an image, of the same ids. Text has the shortest digits
/// that read back as the same number.
///
/// Throws std::system_error when the system refuses.
void WriteColmapModel(const ColmapModel& model, const ColmapValues& values,
                      const std::filesystem::path& folder);

/// The same of a model of which ReadColmapPart has read a part: images and points are copied from
/// file to file. `point_ids` are those of all points, ascending. Throws InputError where the files
/// have changed since.
void RewriteColmapModel(const ColmapModel& model, const std::vector<int64_t>& point_ids,
                        const ColmapValues& values, const std::filesystem::path& folder);

}  // namespace bundle
