#pragma once

/// Rigs of a COLMAP model, as a problem has them.

#include <cstddef>
#include <cstdint>
#include <vector>

namespace bundle {

struct ColmapModel;  // colmap_model.h

/// Rigs with more than a reference camera, as a problem has them. Frames with an image are sorted
/// by id; cameras with a sensor_from_rig are sorted by the ids of rig and camera. All arrays are
/// empty if no such rig has a frame with an image. Other sensors (IMUs, cameras of unknown pose)
/// stay in the files.
struct ColmapRigs {
  struct Place {
    size_t rig;     ///< in index.rigs
    size_t sensor;  ///< in its sensors
  };
  std::vector<size_t> frames;  ///< positions in index.frames
  std::vector<Place> sensors;
  std::vector<int32_t> image_frame;   ///< per row of our images: row in `frames`; -1: none
  std::vector<int32_t> image_sensor;  ///< row in `sensors`; -1: the reference sensor, or no frame
};

/// Fills `image_of_frame` and `rigs` from the index and its order. Throws InputError as
/// ReadColmapModel does.
void FindColmapRigs(ColmapModel* model);

}  // namespace bundle
