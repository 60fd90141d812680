#pragma once

/// Parts of binary COLMAP models, read as streams: only cameras, images and the data of the part
/// are kept.

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/io/colmap_index.h"
#include "core/io/colmap_model.h"
#include "core/scratch/large_vector.h"

namespace bundle {

struct ColmapPart {
  /// First contradiction between tracks and keypoints in the part.
  struct Failure {
    bool is_in_images;  ///< else in points3D.bin, of which ReadColmapModel speaks first
    uint64_t position;
    std::string message;
  };
  ColmapModel model;           ///< cameras, images, rigs and the open files; no points
  LargeVector<double> points;  ///< three of each point with a place
  ColmapObservations observations;
  std::optional<Failure> failure;
};

/// Reads cameras, images, the points that have a place (-1: no place) and their observations, in
/// the order of ReadColmapModel. `point_ids` are those of the survey; places ascend with them from
/// 0 on. Throws InputError if the files have other points.
ColmapPart ReadColmapPart(const std::string& folder, const LargeVector<int64_t>& point_ids,
                          const LargeVector<int32_t>& place, const std::function<void()>& on_block);

}  // namespace bundle
