#pragma once

/// BAL files, read and written.
///
/// From Bundle Adjustment in the Large to COLMAP and back.
///
/// BAL [1] projects a point X by
///     P = R X + t,   p = -(Px, Py) / Pz,   (x, y) = f (1 + k1 |p|^2 + k2 |p|^4) p
/// with x to the right, y up, the camera looking along -z, and the image's origin at the principal
/// point. COLMAP's RADIAL model with principal point (cx, cy) = (0, 0) projects by
///     P' = R' X + t',   p' = (P'x, P'y) / P'z,   (x', y') = f (1 + k1 |p'|^2 + k2 |p'|^4) p'.
/// Turn the camera frame by half a turn about its x axis, D = diag(1, -1, -1), P' = D P. Then
///     p' = (Px, -Py) / (-Pz) = (px, -py),   |p'| = |p|,   so (x', y') = (x, -y)
/// with the same f, k1, k2. The stored points, f, k1, k2 and x do not change; y and two components
/// of t change sign. All of this is exact in floating point.
///
/// R becomes D R. The quaternion of D is the unit i. With q = w + x i + y j + z k the quaternion of
/// R,
///     q' = i q = -x + w i - z j + y k,
/// which is exact, too; the inverse is q = -i q'. Only the conversion between BAL's angle-axis
/// vector and q rounds. It preserves the direction to a few ulp, because it scales all three
/// components by one factor. The sign of q is not changed. So an angle in [0, 2 pi), also above pi,
/// is recovered as 2 atan2(|v|, w). A larger angle is reduced to [0, 2 pi): the rotation is the
/// same, but the numbers differ.
///
/// [1] https://grail.cs.washington.edu/projects/bal/

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "core/io/output_file.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// Converts a BAL camera's rotation (angle-axis, radians) and translation, 6 numbers, to
/// cam_from_world: qx qy qz qw tx ty tz.
inline void CamFromWorldFromBal(const double* bal, double* cam_from_world) {
  const double angle = std::hypot(bal[0], bal[1], bal[2]);
  // sin(angle / 2) / angle; the next term of the series is below half an ulp.
  const double scale = angle < 1e-3 ? 0.5 - angle * angle / 48.0 : std::sin(0.5 * angle) / angle;
  const double x = scale * bal[0];
  const double y = scale * bal[1];
  const double z = scale * bal[2];
  cam_from_world[0] = std::cos(0.5 * angle);
  cam_from_world[1] = -z;
  cam_from_world[2] = y;
  cam_from_world[3] = -x;
  cam_from_world[4] = bal[3];
  cam_from_world[5] = -bal[4];
  cam_from_world[6] = -bal[5];
}

/// The inverse. The quaternion may have any nonzero length. Its sign decides if the angle is below
/// or above pi.
inline void BalFromCamFromWorld(const double* cam_from_world, double* bal) {
  const double w = cam_from_world[0];
  const double x = -cam_from_world[3];
  const double y = cam_from_world[2];
  const double z = -cam_from_world[1];
  const double sine = std::hypot(x, y, z);
  // If the axis has no direction, the rotation is the identity, for either sign of w.
  const double scale = sine > 0.0 ? 2.0 * std::atan2(sine, w) / sine : 0.0;
  bal[0] = scale * x;
  bal[1] = scale * y;
  bal[2] = scale * z;
  bal[3] = cam_from_world[4];
  bal[4] = -cam_from_world[5];
  bal[5] = -cam_from_world[6];
}

/// A BAL problem in COLMAP's conventions, arrays row-major, units pixels and the
/// reconstruction's length unit. Image i has camera i, whose model is RADIAL.
struct BalProblem {
  std::vector<double> cam_from_world;  ///< num_images x 7: qx qy qz qw tx ty tz
  std::vector<double> rotations;       ///< num_images x 3: the file's own angle-axis, radians
  std::vector<double> camera_params;   ///< num_images x 5: f cx cy k1 k2 with cx = cy = 0
  LargeVector<double> points;          ///< num_points x 3
  LargeVector<int32_t> observation_image;
  LargeVector<int32_t> observation_point;
  LargeVector<double> observation_xy;  ///< num_observations x 2
};

/// Reads a BAL file, plain or compressed by gzip or bzip2, as a stream. Keeps the order of cameras,
/// points and observations. Observations may repeat, and points may have any number of them.
///
/// Memory is allocated only as the numbers announced by the header are read. `on_block` is called
/// between blocks of about a megabyte and may throw.
///
/// Throws InputError `NAME:LINE: expected ..., found ...` and std::system_error.
BalProblem ReadBal(const std::filesystem::path& path, const std::function<void()>& on_block);

/// Contents of a BAL file in COLMAP's conventions. The arrays belong to the caller, row-major, in
/// pixels and the reconstruction's length unit. Every image has its own camera.
struct BalView {
  int64_t num_images = 0;
  int64_t num_points = 0;
  int64_t num_observations = 0;
  const double* cam_from_world = nullptr;      ///< num_images x 7: qx qy qz qw tx ty tz
  const double* camera_params = nullptr;       ///< num_images x 5: f cx cy k1 k2
  const double* points = nullptr;              ///< num_points x 3
  const int32_t* observation_image = nullptr;  ///< num_observations
  const int32_t* observation_point = nullptr;  ///< num_observations
  const double* observation_xy = nullptr;      ///< num_observations x 2
  /// num_images x 3, or nullptr: angle-axis vectors that are written instead of those of
  /// cam_from_world, for images with keeps_rotation. The conversion by a quaternion would change
  /// the last bits.
  const double* rotations = nullptr;
  const uint8_t* keeps_rotation = nullptr;  ///< num_images; null only if rotations is null
};

/// Writes a BAL file. Numbers are the shortest that read back as the same double. The principal
/// point is subtracted from the observations, because BAL measures from it.
///
/// `on_block` is called between blocks of about a megabyte and may throw. Throws std::system_error.
void WriteBal(const BalView& problem, const std::filesystem::path& path, Compression compression,
              const std::function<void()>& on_block);

/// Writes a BAL file with the observations of the BAL file `source`, as a stream; ignores those of
/// `problem`. Throws InputError as ReadBal does, and if the counts of the file differ.
void WriteBalLike(const std::filesystem::path& source, const BalView& problem,
                  const std::filesystem::path& path, Compression compression,
                  const std::function<void()>& on_block);

}  // namespace bundle
