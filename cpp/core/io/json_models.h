#pragma once

/// The large tables of reconstructions in JSON: OpenMVG's structure and OpenSfM's points.

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/io/json_columns.h"

namespace bundle {

/// sfm_data.json: landmarks in the order of the file, observations by landmark.
struct OpenMvgStructure {
  std::string rest;                 ///< JSON of the rest of the file
  std::vector<uint32_t> ids;        ///< num_landmarks: their keys
  std::vector<double> points;       ///< num_landmarks x 3
  std::vector<uint32_t> num_views;  ///< num_landmarks: their numbers of observations
  std::vector<uint32_t> view;       ///< num_observations: key of the view
  std::vector<uint32_t> feature;    ///< num_observations
  std::vector<double> xy;           ///< num_observations x 2
};

/// A reconstruction of reconstruction.json.
struct OpenSfmPoints {
  std::string rest;             ///< JSON of the rest of the file, without points
  JsonNames names;              ///< num_points
  std::vector<int64_t> ids;     ///< num_points: the names as numbers; empty if one is no number
  std::vector<double> points;   ///< num_points x 3
  std::vector<uint8_t> colors;  ///< num_points x 3: red, green, blue
};

/// @param on_block called between blocks of about a megabyte; may throw to end the reading.
/// Throws InputError with line and place for contents that violate the format.
OpenMvgStructure ReadOpenMvg(const std::filesystem::path& path,
                             const std::function<void()>& on_block);

/// @param entry number of the reconstruction in the file, from 0.
OpenSfmPoints ReadOpenSfm(const std::filesystem::path& path, int64_t entry,
                          const std::function<void()>& on_block);

}  // namespace bundle
