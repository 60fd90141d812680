#include "core/synthetic/visible_points.h"

#include <cmath>

#include "core/cameras/camera_model.h"
#include "core/geometry/rotation.h"
#include "core/parallel/thread_pool.h"

namespace bundle {

namespace {

constexpr int kSightSamples = 12;

double Dot3(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

double FromRoad(double x, double pitch) { return std::abs(x - pitch * std::nearbyint(x / pitch)); }

/// R (X - c)
void InCamera(const SyntheticImages& images, int64_t image, const double* position, double* out) {
  double from_camera[3];
  for (int k = 0; k < 3; ++k) from_camera[k] = position[k] - images.centers[3 * image + k];
  MatrixVector3(images.rotations + 9 * image, from_camera, out);
}

Projection Project(const SyntheticImages& images, int64_t image, const double* in_camera,
                   double* xy) {
  const double* params = images.params + int64_t{images.cameras[image]} * images.num_params;
  return images.model->project(params, in_camera, xy, nullptr, nullptr);
}

bool IsClear(const SyntheticImages& images, const double* center, const double* position) {
  if (images.pitch == 0) return true;
  for (int i = 0; i < kSightSamples; ++i) {
    const double t = (i + 0.5) / kSightSamples;
    const double x = center[0] + t * (position[0] - center[0]);
    if (FromRoad(x, images.pitch) <= images.clearance) continue;
    const double y = center[1] + t * (position[1] - center[1]);
    if (FromRoad(y, images.pitch) > images.clearance) return false;
  }
  return true;
}

bool Sees(const SyntheticImages& images, int64_t image, const SyntheticPoints& points, int64_t i) {
  const double* position = points.positions + 3 * i;
  const double* normal = points.normals + 3 * i;
  const double* center = images.centers + 3 * image;
  double from_ball[3], to_camera[3], in_camera[3], xy[2];
  for (int k = 0; k < 3; ++k) {
    from_ball[k] = points.keys[3 * i + k] - images.ball_centers[3 * image + k];
    to_camera[k] = center[k] - position[k];
  }
  const double radius = images.ball_radii[image];
  if (Dot3(from_ball, from_ball) > radius * radius) return false;
  const double distance = std::sqrt(Dot3(to_camera, to_camera));
  if (distance > points.reach[i]) return false;
  const bool has_side = Dot3(normal, normal) != 0;
  if (has_side && Dot3(normal, to_camera) < images.min_cosine * distance) return false;
  InCamera(images, image, position, in_camera);
  const double limit = images.max_tangents[image] * in_camera[2];
  const double off_axis = in_camera[0] * in_camera[0] + in_camera[1] * in_camera[1];
  if (in_camera[2] <= 0 || off_axis > limit * limit) return false;
  if (Project(images, image, in_camera, xy) != Projection::kValid) return false;
  const double* size = images.sizes + 2 * image;
  if (!(xy[0] >= 0 && xy[0] <= size[0] && xy[1] >= 0 && xy[1] <= size[1])) return false;
  return IsClear(images, center, position);
}

}  // namespace

std::vector<int64_t> VisiblePoints(const SyntheticImages& images, int64_t image,
                                   const SyntheticPoints& points,
                                   const std::vector<int64_t>& candidates) {
  std::vector<int64_t> seen;
  for (const int64_t candidate : candidates) {
    if (Sees(images, image, points, candidate)) seen.push_back(candidate);
  }
  return seen;
}

void ProjectExactly(const SyntheticImages& images, const double* positions, int64_t count,
                    const int32_t* image, const int32_t* point, int num_threads, double* xy) {
  ParallelFor(count, num_threads, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      double in_camera[3];
      InCamera(images, image[i], positions + 3 * int64_t{point[i]}, in_camera);
      Project(images, image[i], in_camera, xy + 2 * i);
    }
  });
}

}  // namespace bundle
