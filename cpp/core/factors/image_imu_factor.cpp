#include "core/factors/image_imu_factor.h"

#include <algorithm>
#include <utility>

namespace bundle {
namespace {

constexpr int kImuRows = 9, kPose = 6;

std::vector<Retraction> OfTwoImages() {
  const Retraction pose(Manifold::kSe3, 7), vector(Manifold::kEuclidean, 3);
  return {pose, vector, vector, vector, pose, vector};
}

/// out = -rows Ad_{E^-1 X}, rows by world_from_imu.
void ToImage(const Retraction& pose, const double* camera_from_imu, const double* image,
             const double* rows, double* out) {
  double imu_from_world[7], adjoint[kPose * kPose];
  pose.Between(camera_from_imu, image, imu_from_world);
  pose.Adjoint(imu_from_world, adjoint);
  for (int r = 0; r < kImuRows; ++r) {
    for (int c = 0; c < kPose; ++c) {
      double sum = 0;
      for (int k = 0; k < kPose; ++k) sum += rows[kPose * r + k] * adjoint[kPose * k + c];
      out[kPose * r + c] = -sum;
    }
  }
}

}  // namespace

ImageImuFactor::ImageImuFactor(FactorHead head, std::shared_ptr<const Preintegration> motion,
                               std::vector<double> gravity, std::vector<double> camera_from_imu)
    : Factor(head, OfTwoImages(), kImuRows),
      motion_(std::move(head), std::move(motion), std::move(gravity), nullptr,
              /*has_scale=*/false),
      camera_from_imu_(CheckedValue(name() + ": camera_from_imu", retractions()[0],
                                    std::move(camera_from_imu))) {}

bool ImageImuFactor::Evaluate(const double* const* values, double* residual,
                              double* const* jacobians) const {
  const Retraction& pose = retractions()[0];
  double imu[2][7], biases[6];
  for (int k = 0; k < 2; ++k) pose.Between(values[4 * k], camera_from_imu_.data(), imu[k]);
  std::copy_n(values[2], 3, biases);
  std::copy_n(values[3], 3, biases + 3);
  const double* const states[] = {imu[0], values[1], biases, imu[1], values[5]};
  if (jacobians == nullptr) return motion_.Evaluate(states, residual, nullptr);
  double by_pose[2][kImuRows * kPose], by_biases[kImuRows * 6];
  double* const wanted[] = {jacobians[0] != nullptr ? by_pose[0] : nullptr, jacobians[1], by_biases,
                            jacobians[4] != nullptr ? by_pose[1] : nullptr, jacobians[5]};
  if (!motion_.Evaluate(states, residual, wanted)) return false;
  for (int k = 0; k < 2; ++k) {
    if (jacobians[4 * k] == nullptr) continue;
    ToImage(pose, camera_from_imu_.data(), values[4 * k], by_pose[k], jacobians[4 * k]);
  }
  for (int k = 0; k < 2; ++k) {
    if (jacobians[2 + k] == nullptr) continue;
    for (int r = 0; r < kImuRows; ++r) {
      std::copy_n(by_biases + 6 * r + 3 * k, 3, jacobians[2 + k] + 3 * r);
    }
  }
  return true;
}

}  // namespace bundle
