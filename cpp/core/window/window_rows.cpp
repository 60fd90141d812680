#include "core/window/window_rows.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/geometry/rotation.h"
#include "core/inertial/imu_residual.h"

namespace bundle {
namespace {

ImuPose PoseOfState(const double* state) {
  ImuPose pose;
  QuaternionToRotation(state, pose.rotation);
  std::copy_n(state + 4, 3, pose.position);
  return pose;
}

CameraOfImu CameraFrom(const std::array<double, 7>& camera) {
  CameraOfImu result;
  QuaternionToRotation(camera.data(), result.rotation);
  std::copy_n(camera.data() + 4, 3, result.translation);
  return result;
}

/// Where the Jacobians of state i are taken.
const double* PointOfJacobian(const WindowView& view, const WindowState& at, int i) {
  return view.anchored[i] != 0 ? view.anchors + kStateNumbers * i : at.state(i);
}

LandmarkSight SightOf(const WindowView& view, int k) {
  const int l = view.landmarks[k];
  LandmarkSight sight;
  std::copy_n(view.anchor_velocity + 2 * l, 2, sight.anchor_velocity);
  std::copy_n(view.xy + 2 * k, 2, sight.seen);
  std::copy_n(view.xy_velocity + 2 * k, 2, sight.velocity);
  return sight;
}

/// sigma of the walk of each bias, sqrt(T) times its density.
void BiasWalkScales(const Preintegration& imu, double* gyro, double* accel) {
  const double root = std::sqrt(imu.duration());
  *gyro = 1 / (imu.noise().gyro_bias_random_walk * root);
  *accel = 1 / (imu.noise().accel_bias_random_walk * root);
}

void LinearizeImu(const WindowView& view, const WindowState& at, int i, InertialRows* out) {
  const Preintegration& imu = *view.imu[i];
  out->first = i;
  ImuResidual(imu, ImuStateFromRow(at.state(i)), ImuStateFromRow(at.state(i + 1)),
              view.gravity.data(), out->r, nullptr, nullptr, nullptr);
  double unused[9];
  std::fill_n(out->by_first, InertialRows::kRows * kStateTangent, 0.0);
  std::fill_n(out->by_second, InertialRows::kRows * kStateTangent, 0.0);
  ImuResidual(imu, ImuStateFromRow(PointOfJacobian(view, at, i)),
              ImuStateFromRow(PointOfJacobian(view, at, i + 1)), view.gravity.data(), unused,
              out->by_first, out->by_second, nullptr);
  WhitenImu(imu, out->r, 1);
  WhitenImu(imu, out->by_first, kStateTangent);
  WhitenImu(imu, out->by_second, kStateTangent);
  double scales[2];
  BiasWalkScales(imu, &scales[0], &scales[1]);
  for (int k = 0; k < 6; ++k) {
    const double scale = scales[k / 3];
    const int row = 9 + k, column = 9 + k;  // biases are the last six coordinates
    out->r[row] = scale * (at.state(i + 1)[10 + k] - at.state(i)[10 + k]);
    out->by_first[row * kStateTangent + column] = -scale;
    out->by_second[row * kStateTangent + column] = scale;
  }
}

void AddImuCost(const WindowView& view, const WindowState& at, int i, WindowCosts* costs) {
  const Preintegration& imu = *view.imu[i];
  double r[9];
  ImuResidual(imu, ImuStateFromRow(at.state(i)), ImuStateFromRow(at.state(i + 1)),
              view.gravity.data(), r, nullptr, nullptr, nullptr);
  WhitenImu(imu, r, 1);
  for (const double x : r) costs->imu += 0.5 * x * x;
  double scales[2];
  BiasWalkScales(imu, &scales[0], &scales[1]);
  for (int k = 0; k < 6; ++k) {
    const double x = scales[k / 3] * (at.state(i + 1)[10 + k] - at.state(i)[10 + k]);
    costs->bias_walk += 0.5 * x * x;
  }
}

struct WindowPoses {
  std::vector<ImuPose> now, jacobian;
  CameraOfImu camera;

  WindowPoses(const WindowView& view, const WindowState& at)
      : camera(CameraFrom(at.camera_from_imu)) {
    for (int i = 0; i < view.num_states; ++i) {
      now.push_back(PoseOfState(at.state(i)));
      jacobian.push_back(view.anchored[i] != 0 ? PoseOfState(view.anchors + kStateNumbers * i)
                                               : now.back());
    }
  }
};

/// Appends the rows of an observation; false where it has no value.
bool LinearizeSight(const WindowView& view, const WindowState& at, const WindowPoses& poses, int k,
                    WindowRows* rows) {
  const int l = view.landmarks[k];
  VisualRows row;
  row.landmark = l;
  row.anchor = view.anchor_states[l];
  row.observer = view.observers[k];
  const LandmarkSight sight = SightOf(view, k);
  const double* const point = at.point(l);
  const bool is_anchored = view.anchored[row.anchor] != 0 || view.anchored[row.observer] != 0;
  if (!InverseDepthResidual(poses.now[row.anchor], poses.now[row.observer], poses.camera, point,
                            at.time_offset, sight, view.sigma, row.r,
                            is_anchored ? nullptr : &row.by)) {
    return false;
  }
  double unused[2];
  if (is_anchored &&
      !InverseDepthResidual(poses.jacobian[row.anchor], poses.jacobian[row.observer], poses.camera,
                            point, at.time_offset, sight, view.sigma, unused, &row.by)) {
    return false;
  }
  const double squared = row.r[0] * row.r[0] + row.r[1] * row.r[1];
  double rho[3];
  ValueOfLoss(view.loss, view.loss_scale, squared, rho);
  rows->costs.visual += 0.5 * rho[0];
  const double weight = std::sqrt(rho[1]);  // of a loss with rho'' <= 0 (factors/loss.h)
  if (weight != 1) {
    for (double& x : row.r) x *= weight;
    for (double& x : row.by.by_anchor) x *= weight;
    for (double& x : row.by.by_observer) x *= weight;
    for (double& x : row.by.by_camera) x *= weight;
    for (double& x : row.by.by_time) x *= weight;
    for (double& x : row.by.by_point) x *= weight;
  }
  rows->visual.push_back(row);
  return true;
}

/// The anchoring image's observation of a landmark; adds 1/2 rho.
AnchorRows LinearizeAnchor(const WindowView& view, const WindowState& at, int landmark,
                           double* cost) {
  AnchorRows row;
  row.landmark = landmark;
  double rho[3];
  for (int k = 0; k < 2; ++k) {
    row.r[k] = (at.point(landmark)[k] - view.anchor_xy[2 * landmark + k]) / view.sigma;
  }
  ValueOfLoss(view.loss, view.loss_scale, row.r[0] * row.r[0] + row.r[1] * row.r[1], rho);
  *cost += 0.5 * rho[0];
  const double weight = std::sqrt(rho[1]);
  row.scale = weight / view.sigma;
  for (double& x : row.r) x *= weight;
  return row;
}

}  // namespace

void LinearizeWindow(const WindowView& view, const WindowState& at,
                     const FactorSelection& selection, WindowRows* rows) {
  rows->is_finite = true;
  rows->costs = {};
  rows->visual.clear();
  rows->anchors.clear();
  rows->inertial.clear();
  rows->priors.clear();
  const WindowPoses poses(view, at);
  for (int k = 0; k < view.num_observations; ++k) {
    if (!selection.all && selection.landmarks[view.landmarks[k]] == 0) continue;
    if (!LinearizeSight(view, at, poses, k, rows)) rows->is_finite = false;
  }
  for (const VisualRows& row : rows->visual) {
    if (!rows->anchors.empty() && rows->anchors.back().landmark == row.landmark) continue;
    rows->anchors.push_back(LinearizeAnchor(view, at, row.landmark, &rows->costs.visual));
  }
  for (size_t i = 0; i < view.imu.size(); ++i) {
    if (view.imu[i] == nullptr || (!selection.all && selection.imu[i] == 0)) continue;
    InertialRows& row = rows->inertial.emplace_back();
    LinearizeImu(view, at, static_cast<int>(i), &row);
    for (int k = 0; k < InertialRows::kRows; ++k) {
      (k < 9 ? rows->costs.imu : rows->costs.bias_walk) += 0.5 * row.r[k] * row.r[k];
    }
  }
  for (const WindowPrior& prior : view.priors) {
    rows->priors.push_back(LinearizePrior(view, prior, at));
    rows->costs.prior += rows->priors.back().cost;
  }
}

std::vector<double> VisualResidualNorms(const WindowView& view, const WindowState& at) {
  const WindowPoses poses(view, at);
  std::vector<double> norms(view.num_observations, std::numeric_limits<double>::infinity());
  for (int k = 0; k < view.num_observations; ++k) {
    const int l = view.landmarks[k];
    double r[2];
    if (InverseDepthResidual(poses.now[view.anchor_states[l]], poses.now[view.observers[k]],
                             poses.camera, at.point(l), at.time_offset, SightOf(view, k),
                             view.sigma, r, nullptr)) {
      norms[k] = std::sqrt(r[0] * r[0] + r[1] * r[1]);
    }
  }
  return norms;
}

WindowCosts CostsOfWindow(const WindowView& view, const WindowState& at) {
  WindowCosts costs;
  for (const double norm : VisualResidualNorms(view, at)) {
    double rho[3];
    ValueOfLoss(view.loss, view.loss_scale, norm * norm, rho);
    costs.visual += 0.5 * rho[0];
    if (!(norm < std::numeric_limits<double>::infinity())) {
      costs.visual = norm;  // a bounded loss would hide it
      return costs;
    }
  }
  for (int k = 0, last = -1; k < view.num_observations; ++k) {
    if (view.landmarks[k] == last) continue;
    last = view.landmarks[k];
    LinearizeAnchor(view, at, last, &costs.visual);
  }
  for (size_t i = 0; i < view.imu.size(); ++i) {
    if (view.imu[i] != nullptr) AddImuCost(view, at, static_cast<int>(i), &costs);
  }
  for (const WindowPrior& prior : view.priors) {
    costs.prior += CostOfPrior(view, prior, at);
  }
  return costs;
}

}  // namespace bundle
