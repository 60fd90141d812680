#pragma once

/// Points of a synthetic scene that an image sees.
///
/// A point X with unit normal n (zero: seen from all sides), key k and reach d is seen by an image
/// with rotation R, centre c and a ball (b, r) in the space of the keys if
///     |k - b| <= r,   |c - X| <= d,   n . (c - X) >= min_cosine |c - X|   or n = 0,
///     P = R (X - c) has Pz > 0 and |(Px, Py)| <= max_tangent Pz,   its projection is in the image,
/// and no occluder is in between. Occluders are the blocks of a town with a road along every
/// multiple of `pitch` in x and in y: a place is in a block if both of its distances from the
/// middle of the nearest road are above `clearance`. The line of sight is sampled at c + t (X - c),
/// t = (i + 1/2) / 12.

#include <cstdint>
#include <vector>

namespace bundle {

struct CameraModel;

/// View of the images of a scene; one row per image.
struct SyntheticImages {
  int64_t num_images = 0;
  const double* centers = nullptr;       ///< 3, world
  const double* rotations = nullptr;     ///< 3 x 3, camera from world
  const double* ball_centers = nullptr;  ///< 3, in the space of the keys
  const double* ball_radii = nullptr;
  const double* max_tangents = nullptr;
  const double* sizes = nullptr;     ///< 2, pixels
  const double* richness = nullptr;  ///< relative density of observations
  const int32_t* cameras = nullptr;  ///< a row of params
  const double* params = nullptr;
  int num_params = 0;
  const CameraModel* model = nullptr;
  double min_cosine = 0;
  double pitch = 0;  ///< distance between roads; 0: no occlusion
  double clearance = 0;
};

/// View of the points; one row per point.
struct SyntheticPoints {
  int64_t num_points = 0;
  const double* positions = nullptr;  ///< 3, world
  const double* normals = nullptr;    ///< 3
  const double* reach = nullptr;      ///< 1
  const double* keys = nullptr;       ///< 3
};

/// The candidates (indices of points) that an image sees, in their order.
std::vector<int64_t> VisiblePoints(const SyntheticImages& images, int64_t image,
                                   const SyntheticPoints& points,
                                   const std::vector<int64_t>& candidates);

/// Writes the projections of points (3 numbers each) by images to xy (2 each), in pixels without
/// noise.
void ProjectExactly(const SyntheticImages& images, const double* positions, int64_t count,
                    const int32_t* image, const int32_t* point, int num_threads, double* xy);

}  // namespace bundle
