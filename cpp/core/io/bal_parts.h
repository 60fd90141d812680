#pragma once

/// Parts of BAL files, read as a stream; only the data of the part are stored.

#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "core/io/bal.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// Survey of a BAL file: the images that see each point.
struct BalSurvey {
  int32_t num_images = 0;
  int32_t num_observations = 0;
  LargeVector<int32_t> first_image;  ///< num_points; num_images for a point that no image sees
  LargeVector<int32_t> last_image;   ///< num_points; -1 for a point that no image sees
  LargeVector<int32_t> num_seen;     ///< num_points: observations of a point
};

/// Reads a complete file and throws as ReadBal.
BalSurvey SurveyBal(const std::filesystem::path& path, const std::function<void()>& on_block);

/// Reads a file and stores its cameras, the points that have a place (-1: no place) and their
/// observations, in the order of the file. Places ascend from 0 on. Throws as ReadBal, and
/// InputError if the number of points differs.
BalProblem ReadBalPart(const std::filesystem::path& path, const LargeVector<int32_t>& place,
                       const std::function<void()>& on_block);

}  // namespace bundle
