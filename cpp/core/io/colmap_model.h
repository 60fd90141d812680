#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/io/colmap_index.h"
#include "core/io/colmap_observations.h"

namespace bundle {

/// A COLMAP model as it was read: its files, checked, what stands in them, and the order of our
/// arrays, which is that of the ids. The files stay in memory, so that `colmap_writer.h` can write
/// them again with other numbers whatever has become of them on the disk.
struct ColmapModel {
  ColmapIndex index;
  std::vector<size_t> cameras_by_id;  ///< positions in `index`
  std::vector<size_t> images_by_id;
  std::vector<size_t> points_by_id;
  /// Of each frame, the row of its image in our arrays; -1 for one without an image.
  std::vector<int64_t> image_of_frame;
  ColmapObservations observations;

  bool is_binary() const { return index.kind == ModelFile::Kind::kBinary; }
  /// Models from before there were rigs and frames have neither.
  bool has_frames() const { return !index.rigs.empty() || !index.frames.empty(); }

  /// (num_images, 7) qx qy qz qw tx ty tz. The pose of an image is its frame's where there are any.
  std::vector<double> CamFromWorld() const;
};

/// Reads a model as CheckColmapModel does, and keeps it. Throws InputError as that does, and for a
/// rig of several sensors or a frame of several images, which our problem does not have.
ColmapModel ReadColmapModel(const std::string& folder);

}  // namespace bundle
