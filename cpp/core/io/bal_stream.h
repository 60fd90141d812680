#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <vector>

#include "core/io/bal.h"
#include "core/io/number_writer.h"
#include "core/io/output_file.h"

namespace bundle {

/// BAL files with the same observations, written as a stream: observations, then the cameras of
/// each file, then its points. The number of observations at the beginning of a file is known only
/// at the end; Close overwrites blanks with it.
///
/// Parts whose function is not called are missing in the files. Throws std::system_error;
/// `on_block` as in WriteBal.
class BalStream {
 public:
  BalStream(const std::vector<std::filesystem::path>& paths, int64_t num_images, int64_t num_points,
            std::function<void()> on_block);

  /// Observations and camera_params (for the principal points) of a part, the same in all files.
  void AddObservations(const BalView& part);
  /// cam_from_world and camera_params.
  void AddCameras(int file, const BalView& part);
  void AddPoints(int file, const BalView& part);
  void Close();

  /// Name of the first file, for messages.
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
  int64_t num_images_;
  int64_t num_points_;
  int64_t num_observations_ = 0;
  std::function<void()> on_block_;
  std::deque<OutputFile> files_;  // a deque, because files cannot be moved
};

}  // namespace bundle
