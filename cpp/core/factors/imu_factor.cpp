#include "core/factors/imu_factor.h"

#include <algorithm>
#include <utility>

#include "core/geometry/rotation.h"
#include "core/inertial/imu_residual.h"

namespace bundle {

namespace {

constexpr int kRows = 9, kStateSize = 15;

std::vector<Retraction> RetractionsOfImu(const Retraction* gravity, bool has_scale) {
  const Retraction pose(Manifold::kSe3, 7), velocity(Manifold::kEuclidean, 3);
  std::vector<Retraction> out = {pose, velocity, {Manifold::kEuclidean, 6}, pose, velocity};
  if (gravity != nullptr) {
    out.push_back(gravity->manifold() == Manifold::kSo3 ? *gravity : velocity);
  }
  if (has_scale) out.emplace_back(Manifold::kEuclidean, 1);
  return out;
}

/// The state from a pose and a velocity, with positions times the scale, without biases.
ImuState StateOfPose(const double* pose, const double* velocity, double scale) {
  ImuState state = {};
  QuaternionToRotation(pose, state.rotation);
  for (int i = 0; i < 3; ++i) {
    state.position[i] = scale * pose[4 + i];
    state.velocity[i] = velocity[i];
  }
  return state;
}

/// Converts columns of a Jacobian w.r.t. 15 coordinates to those of a pose: rotation, position
/// times scale R.
void PoseColumns(const double* by_state, const double* rotation, double scale, double* out) {
  for (int r = 0; r < kRows; ++r) {
    double by_position[3];
    VectorMatrix3(by_state + kStateSize * r + 3, rotation, by_position);
    for (int i = 0; i < 3; ++i) {
      out[6 * r + i] = by_state[kStateSize * r + i];
      out[6 * r + 3 + i] = scale * by_position[i];
    }
  }
}

void Columns(const double* by_state, int first, int count, double* out) {
  for (int r = 0; r < kRows; ++r) {
    std::copy_n(by_state + kStateSize * r + first, count, out + count * r);
  }
}

}  // namespace

ImuFactor::ImuFactor(FactorHead head, std::shared_ptr<const Preintegration> motion,
                     std::vector<double> gravity, const Retraction* variable, bool has_scale)
    : Factor(std::move(head), RetractionsOfImu(variable, has_scale), kRows),
      motion_(std::move(motion)),
      gravity_(CheckedValue(name() + ": gravity", Retraction(Manifold::kEuclidean, 3),
                            std::move(gravity))),
      has_gravity_(variable != nullptr),
      has_scale_(has_scale) {
  try {
    motion_->sqrt_information();
  } catch (const InputError& error) {
    throw InputError(name() + ": " + error.what());
  }
}

bool ImuFactor::Evaluate(const double* const* values, double* residual,
                         double* const* jacobians) const {
  const int scale_block = has_gravity_ ? 6 : 5;
  const double scale = has_scale_ ? values[scale_block][0] : 1;
  ImuState i = StateOfPose(values[0], values[1], scale);
  const ImuState j = StateOfPose(values[3], values[4], scale);
  std::copy_n(values[2], 3, i.gyro_bias);
  std::copy_n(values[2] + 3, 3, i.accel_bias);
  double gravity[3], turn[9];
  std::copy_n(gravity_.data(), 3, gravity);
  const bool turned = has_gravity_ && retractions()[5].manifold() == Manifold::kSo3;
  if (turned) {
    QuaternionToRotation(values[5], turn);
    MatrixVector3(turn, gravity_.data(), gravity);
  } else if (has_gravity_) {
    std::copy_n(values[5], 3, gravity);
  }
  if (jacobians == nullptr) {
    ImuResidual(*motion_, i, j, gravity, residual, nullptr, nullptr, nullptr);
    WhitenImu(*motion_, residual, 1);
    return true;
  }
  double by_i[kRows * kStateSize], by_j[kRows * kStateSize], by_gravity[kRows * 3];
  ImuResidual(*motion_, i, j, gravity, residual, by_i, by_j, by_gravity);
  WhitenImu(*motion_, residual, 1);
  WhitenImu(*motion_, by_i, kStateSize);
  WhitenImu(*motion_, by_j, kStateSize);
  if (jacobians[0] != nullptr) PoseColumns(by_i, i.rotation, scale, jacobians[0]);
  if (jacobians[1] != nullptr) Columns(by_i, 6, 3, jacobians[1]);
  if (jacobians[2] != nullptr) Columns(by_i, 9, 6, jacobians[2]);
  if (jacobians[3] != nullptr) PoseColumns(by_j, j.rotation, scale, jacobians[3]);
  if (jacobians[4] != nullptr) Columns(by_j, 6, 3, jacobians[4]);
  if (has_gravity_ && jacobians[5] != nullptr) {
    WhitenImu(*motion_, by_gravity, 3);
    if (turned) {
      double skew[9], by_turn[9], product[27];
      Skew(gravity_.data(), skew);
      MatrixProduct3(turn, skew, by_turn);
      for (int r = 0; r < kRows; ++r) VectorMatrix3(by_gravity + 3 * r, by_turn, product + 3 * r);
      for (int k = 0; k < kRows * 3; ++k) by_gravity[k] = -product[k];
    }
    std::copy_n(by_gravity, kRows * 3, jacobians[5]);
  }
  if (has_scale_ && jacobians[scale_block] != nullptr) {
    for (int r = 0; r < kRows; ++r) {
      double sum = 0;
      for (int k = 0; k < 3; ++k) {
        sum += by_i[kStateSize * r + 3 + k] * values[0][4 + k] +
               by_j[kStateSize * r + 3 + k] * values[3][4 + k];
      }
      jacobians[scale_block][r] = sum;
    }
  }
  return true;
}

}  // namespace bundle
