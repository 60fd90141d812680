#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

namespace bundle {

/// A BAL problem in COLMAP's conventions (bal_convention.h), arrays row-major, units pixels and the
/// reconstruction's length unit. Image i has camera i, whose model is RADIAL.
struct BalProblem {
  std::vector<double> cam_from_world;  ///< num_images x 7: qx qy qz qw tx ty tz
  std::vector<double> rotations;       ///< num_images x 3: the file's own angle-axis, radians
  std::vector<double> camera_params;   ///< num_images x 5: f cx cy k1 k2 with cx = cy = 0
  std::vector<double> points;          ///< num_points x 3
  std::vector<int32_t> observation_image;
  std::vector<int32_t> observation_point;
  std::vector<double> observation_xy;  ///< num_observations x 2
};

/// Reads a BAL file, plain or compressed by gzip or bzip2, as a stream. The order of cameras,
/// points and observations stays; observations may repeat and points may have any number of them.
///
/// Memory is taken only as the file proves to hold the numbers that its header promises.
/// `on_block` is called between blocks of about a megabyte and may throw.
///
/// Throws InputError `NAME:LINE: expected ..., found ...` and std::system_error.
BalProblem ReadBal(const std::filesystem::path& path, const std::function<void()>& on_block);

}  // namespace bundle
