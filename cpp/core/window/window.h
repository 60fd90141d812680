#pragma once

/// A visual-inertial window: states of an IMU at some instants, landmarks by inverse depth, and
/// their measurements.
///
/// A state is 16 numbers, `qx qy qz qw  px py pz  vx vy vz  bgx bgy bgz  bax bay baz`:
/// world_from_imu, the velocity in the world, biases of gyroscope and accelerometer. It has 15
/// tangent coordinates in two blocks,
///
///   pose    rotation d (R Exp(d)), position (in the world, added)             6
///   motion  velocity, gyroscope bias, accelerometer bias (all added)          9
///
/// because image observations depend on poses only. Two more blocks may be free: camera_from_imu
/// (rotation R Exp(d), translation, both as stored) and the time offset. Blocks of n states are
/// numbered 2 i (pose of state i), 2 i + 1 (its motion), 2 n (camera), 2 n + 1 (time offset).
///
/// The cost is 1/2 sum rho(||r||^2) of observations (inverse_depth.h), preintegrated IMU samples
/// (inertial/imu_residual.h), steps of the biases' random walk, and priors.
///
/// First-estimate Jacobians (FEJ). A prior from marginalisation is linearised at the estimates at
/// that time. It has no information along the four unobservable directions (position and yaw) at
/// these estimates. A factor linearised at a newer estimate has no information along slightly
/// different directions. Together, both seem to determine yaw, although no measurement does.
/// Therefore each state in a prior has an `anchor`, its estimate when it first entered a prior, at
/// which all its Jacobians are taken. Residuals are those of the current estimates. (G. Huang, A.
/// Mourikis, S. Roumeliotis, Observability-based rules for designing consistent EKF SLAM
/// estimators, IJRR 29, 2010; J. Hesch et al., Consistency analysis and improvement of vision-aided
/// inertial navigation, TRO 30, 2014.)

#include <array>
#include <cstdint>
#include <vector>

#include "core/factors/loss.h"
#include "core/factors/reprojection.h"
#include "core/inertial/preintegration.h"

namespace bundle {

inline constexpr int kStateNumbers = 16;
inline constexpr int kMotionSize = 9, kStateTangent = kPoseSize + kMotionSize;

/// A quadratic form of d = (current values of blocks) - `points`, one block after the other:
///
///   square root:  1/2 ||M d + v||^2,       information:  constant - v^T d + 1/2 d^T M d.
struct WindowPrior {
  std::vector<int> blocks;
  /// One row of 16 numbers per block: the state of a pose or motion. The camera uses the first 7
  /// numbers, the time offset the first.
  std::vector<double> points;
  bool is_square_root = false;
  int num_rows = 0;            ///< rows of M
  std::vector<double> matrix;  ///< M, row-major
  std::vector<double> vector;
  double constant = 0;
};

/// View of a caller's arrays; the caller keeps them alive.
struct WindowView {
  int num_states = 0;
  const double* states = nullptr;     ///< n x 16
  const double* anchors = nullptr;    ///< n x 16
  const uint8_t* anchored = nullptr;  ///< n: 1 if Jacobians are taken at the anchor

  std::array<double, 7> camera_from_imu{};
  double time_offset = 0;  ///< seconds: image stamps plus this are times of the states
  bool refine_camera = false;
  bool refine_time_offset = false;

  int num_landmarks = 0;
  const double* points = nullptr;  ///< m x 3: x, y, 1 / z in the anchoring image (inverse_depth.h)
  const int32_t* anchor_states = nullptr;  ///< the state of the anchoring image
  const double* anchor_xy = nullptr;  ///< m x 2, observation in the anchoring image, normalised
  const double* anchor_velocity = nullptr;  ///< m x 2, velocity of these coordinates, 1/s

  int num_observations = 0;  ///< observations in other images, sorted by landmark
  const int32_t* landmarks = nullptr;
  const int32_t* observers = nullptr;   ///< index of the observing state
  const double* xy = nullptr;           ///< k x 2, normalised
  const double* xy_velocity = nullptr;  ///< k x 2, 1/s
  double sigma = 1;                     ///< sigma of a normalised coordinate
  LossType loss = LossType::kTrivial;
  double loss_scale = 1;  ///< in sigmas

  std::vector<const Preintegration*> imu;  ///< n - 1: from state i to i + 1; nullptr: no samples
  std::array<double, 3> gravity{};
  std::vector<WindowPrior> priors;

  int num_blocks() const { return 2 * num_states + 2; }
  int camera_block() const { return 2 * num_states; }
  int time_block() const { return 2 * num_states + 1; }
  /// Tangent size of a block; 0 for a constant block.
  int BlockSize(int block) const {
    if (block == camera_block()) return refine_camera ? 6 : 0;
    if (block == time_block()) return refine_time_offset ? 1 : 0;
    return block % 2 == 0 ? kPoseSize : kMotionSize;
  }
};

/// Tangent size of a prior's block, in a window with `num_states` states; the same for free and
/// constant blocks.
inline int PriorBlockSize(int block, int num_states) {
  if (block == 2 * num_states) return 6;
  if (block == 2 * num_states + 1) return 1;
  return block % 2 == 0 ? kPoseSize : kMotionSize;
}

/// Values that a solve changes.
struct WindowState {
  std::vector<double> states;
  std::vector<double> points;
  std::array<double, 7> camera_from_imu{};
  double time_offset = 0;

  WindowState() = default;
  explicit WindowState(const WindowView& view)
      : states(view.states, view.states + kStateNumbers * view.num_states),
        points(view.points, view.points + 3 * size_t(view.num_landmarks)),
        camera_from_imu(view.camera_from_imu),
        time_offset(view.time_offset) {}

  const double* state(int i) const { return states.data() + kStateNumbers * i; }
  const double* point(int l) const { return points.data() + 3 * size_t(l); }
};

/// out = state + d, 15 tangent coordinates; `out` may be `state`.
void MoveState(const double* state, const double* d, double* out);
/// The coordinates d of `state` about `point`, of 15: MoveState(point, d) is `state`.
void StateFrom(const double* point, const double* state, double* d);
/// The same two functions for camera_from_imu, with 7 numbers and 6 coordinates.
void MoveCamera(const double* camera, const double* d, double* out);
void CameraFromPoint(const double* point, const double* camera, double* d);

/// 1/2 sum rho of each family of factors.
struct WindowCosts {
  double visual = 0, imu = 0, bias_walk = 0, prior = 0;
  double Total() const { return visual + imu + bias_walk + prior; }
};

}  // namespace bundle
