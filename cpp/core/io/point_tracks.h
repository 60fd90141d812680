#pragma once

/// Readers of tracks in the text formats of other programs: points with their views (Bundler, NVM),
/// and OpenSfM's table of tracks.
///
///   x y z  r g b  n  (image key x y) * n         a point of Bundler and NVM; any line breaks
///   image  track  key  x  y  scale  r g b ...    a line of tracks.csv, separated by tabs
///
/// Bundler: N. Snavely, https://www.cs.cornell.edu/~snavely/bundler/bundler-v0.4-manual.html
/// NVM: C. Wu, http://ccwu.me/vsfm/doc.html#nvm
/// tracks.csv: https://opensfm.org/docs/dataset.html

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace bundle {

/// Observations in the order of the file.
struct PointTracks {
  std::vector<double> points;   ///< num_points x 3 (only of Bundler and NVM)
  std::vector<uint8_t> colors;  ///< num_points x 3: red, green, blue (only of Bundler and NVM)
  std::vector<int32_t> image;   ///< index of the image
  std::vector<int32_t> point;   ///< index of the point
  std::vector<int32_t> key;     ///< index of the keypoint in its image, as in the file
  std::vector<double> xy;       ///< num_observations x 2, as in the file
  std::vector<double> scale;    ///< num_observations (only of tracks.csv from version 1)
  int64_t num_skipped = 0;      ///< lines of tracks.csv with another image or track
  int64_t next_line = 0;        ///< line of `next`
  std::string next;             ///< first token after the points; "" at the end of the file
};

/// Reads the points of a Bundler or NVM file.
///
/// @param skip bytes before the points (after decompression), which have `num_lines` lines.
/// @param on_block called between blocks of about a megabyte; may throw to end the reading.
/// Throws InputError with the line for contents that violate the format.
PointTracks ReadPointTracks(const std::filesystem::path& path, int64_t skip, int64_t num_lines,
                            int64_t num_images, int64_t num_points,
                            const std::function<void()>& on_block);

/// Reads the observations of tracks.csv whose image and track are listed; indices are positions in
/// these lists.
PointTracks ReadTracksCsv(const std::filesystem::path& path,
                          const std::vector<std::string_view>& images,
                          const std::vector<std::string_view>& tracks,
                          const std::function<void()>& on_block);

}  // namespace bundle
