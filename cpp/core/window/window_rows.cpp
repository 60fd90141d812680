#include "core/window/window_rows.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/geometry/rotation.h"
#include "core/inertial/imu_residual.h"

namespace bundle {
namespace {

CameraOfImu CameraFrom(const std::array<double, 7>& camera) {
  CameraOfImu result;
  QuaternionToRotation(camera.data(), result.rotation);
  std::copy_n(camera.data() + 4, 3, result.translation);
  return result;
}

/// The states as matrices: those for residuals and those for Jacobians.
struct WindowStates {
  std::vector<ImuState> now, jacobian;
  CameraOfImu camera;

  WindowStates(const WindowView& view, const WindowState& at)
      : camera(CameraFrom(at.camera_from_imu)) {
    for (int i = 0; i < view.num_states; ++i) {
      now.push_back(ImuStateFromRow(at.state(i)));
      jacobian.push_back(view.anchored[i] != 0 ? ImuStateFromRow(view.anchors + kStateNumbers * i)
                                               : now.back());
    }
  }
};

LandmarkSight SightOf(const WindowView& view, int k) {
  const int l = view.landmarks[k];
  LandmarkSight sight;
  std::copy_n(view.anchor_velocity + 2 * l, 2, sight.anchor_velocity);
  std::copy_n(view.xy + 2 * k, 2, sight.seen);
  std::copy_n(view.xy_velocity + 2 * k, 2, sight.velocity);
  return sight;
}

/// Sigma of the random walk of each bias: sqrt(T) times its density.
void BiasWalkScales(const Preintegration& imu, double* gyro, double* accel) {
  const double root = std::sqrt(imu.duration());
  *gyro = 1 / (imu.noise().gyro_bias_random_walk * root);
  *accel = 1 / (imu.noise().accel_bias_random_walk * root);
}

/// The rows of the biases' random walk: six numbers, each divided by its sigma.
void BiasWalk(const Preintegration& imu, const ImuState& i, const ImuState& j, double scales[6],
              double r[6]) {
  double of_bias[2];
  BiasWalkScales(imu, &of_bias[0], &of_bias[1]);
  for (int k = 0; k < 3; ++k) {
    scales[k] = of_bias[0];
    scales[3 + k] = of_bias[1];
    r[k] = scales[k] * (j.gyro_bias[k] - i.gyro_bias[k]);
    r[3 + k] = scales[3 + k] * (j.accel_bias[k] - i.accel_bias[k]);
  }
}

void LinearizeImu(const WindowView& view, const WindowStates& states, int i, InertialRows* out) {
  const Preintegration& imu = *view.imu[i];
  out->first = i;
  std::fill_n(out->by_first, InertialRows::kRows * kStateTangent, 0.0);
  std::fill_n(out->by_second, InertialRows::kRows * kStateTangent, 0.0);
  ImuResidual(imu, states.jacobian[i], states.jacobian[i + 1], view.gravity.data(), out->r,
              out->by_first, out->by_second, nullptr);
  if (view.anchored[i] != 0 || view.anchored[i + 1] != 0) {
    ImuResidual(imu, states.now[i], states.now[i + 1], view.gravity.data(), out->r, nullptr,
                nullptr, nullptr);
  }
  WhitenImu(imu, out->r, 1);
  WhitenImu(imu, out->by_first, kStateTangent);
  WhitenImu(imu, out->by_second, kStateTangent);
  double scales[6];
  BiasWalk(imu, states.now[i], states.now[i + 1], scales, out->r + 9);
  for (int k = 0; k < 6; ++k) {
    const int row = 9 + k, column = 9 + k;  // biases are the last six coordinates
    out->by_first[row * kStateTangent + column] = -scales[k];
    out->by_second[row * kStateTangent + column] = scales[k];
  }
}

void AddImuCost(const WindowView& view, const WindowStates& states, int i, WindowCosts* costs) {
  const Preintegration& imu = *view.imu[i];
  double r[9], scales[6], walk[6];
  ImuResidual(imu, states.now[i], states.now[i + 1], view.gravity.data(), r, nullptr, nullptr,
              nullptr);
  WhitenImu(imu, r, 1);
  for (const double x : r) costs->imu += 0.5 * x * x;
  BiasWalk(imu, states.now[i], states.now[i + 1], scales, walk);
  for (const double x : walk) costs->bias_walk += 0.5 * x * x;
}

/// The residual of observation k at the current states or, for `jacobians`, at their linearisation
/// points.
bool ResidualOfSight(const WindowView& view, const WindowState& at,
                     const std::vector<ImuState>& states, const CameraOfImu& camera, int k,
                     double r[2], DepthJacobians* jacobians) {
  const int l = view.landmarks[k];
  return InverseDepthResidual(states[view.anchor_states[l]], states[view.observers[k]], camera,
                              at.point(l), at.time_offset, SightOf(view, k), view.sigma, r,
                              jacobians);
}

/// Appends the rows of an observation; false if it has no value.
bool LinearizeSight(const WindowView& view, const WindowState& at, const WindowStates& states,
                    int k, WindowRows* rows) {
  VisualRows row;
  row.landmark = view.landmarks[k];
  row.anchor = view.anchor_states[row.landmark];
  row.observer = view.observers[k];
  const bool is_anchored = view.anchored[row.anchor] != 0 || view.anchored[row.observer] != 0;
  if (!ResidualOfSight(view, at, states.jacobian, states.camera, k, row.r, &row.by) ||
      (is_anchored && !ResidualOfSight(view, at, states.now, states.camera, k, row.r, nullptr))) {
    return false;
  }
  const double squared = row.r[0] * row.r[0] + row.r[1] * row.r[1];
  double rho[3];
  ValueOfLoss(view.loss, view.loss_scale, squared, rho);
  rows->costs.visual += 0.5 * rho[0];
  const double weight = std::sqrt(rho[1]);  // for a loss with rho'' <= 0 (factors/loss.h)
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

std::vector<double> ResidualNorms(const WindowView& view, const WindowState& at,
                                  const WindowStates& states) {
  std::vector<double> norms(view.num_observations, std::numeric_limits<double>::infinity());
  for (int k = 0; k < view.num_observations; ++k) {
    double r[2];
    if (ResidualOfSight(view, at, states.now, states.camera, k, r, nullptr)) {
      norms[k] = std::sqrt(r[0] * r[0] + r[1] * r[1]);
    }
  }
  return norms;
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
  const WindowStates states(view, at);
  for (int k = 0; k < view.num_observations; ++k) {
    if (!selection.all && selection.landmarks[view.landmarks[k]] == 0) continue;
    if (!LinearizeSight(view, at, states, k, rows)) rows->is_finite = false;
  }
  for (const VisualRows& row : rows->visual) {
    if (!rows->anchors.empty() && rows->anchors.back().landmark == row.landmark) continue;
    rows->anchors.push_back(LinearizeAnchor(view, at, row.landmark, &rows->costs.visual));
  }
  for (size_t i = 0; i < view.imu.size(); ++i) {
    if (view.imu[i] == nullptr || (!selection.all && selection.imu[i] == 0)) continue;
    InertialRows& row = rows->inertial.emplace_back();
    LinearizeImu(view, states, static_cast<int>(i), &row);
    for (int k = 0; k < InertialRows::kRows; ++k) {
      (k < InertialRows::kImuRows ? rows->costs.imu : rows->costs.bias_walk) +=
          0.5 * row.r[k] * row.r[k];
    }
  }
  for (const WindowPrior& prior : view.priors) {
    rows->priors.push_back(LinearizePrior(view, prior, at));
    rows->costs.prior += rows->priors.back().cost;
  }
}

std::vector<double> VisualResidualNorms(const WindowView& view, const WindowState& at) {
  return ResidualNorms(view, at, WindowStates(view, at));
}

WindowCosts CostsOfWindow(const WindowView& view, const WindowState& at) {
  WindowCosts costs;
  const WindowStates states(view, at);
  for (const double norm : ResidualNorms(view, at, states)) {
    double rho[3];
    ValueOfLoss(view.loss, view.loss_scale, norm * norm, rho);
    costs.visual += 0.5 * rho[0];
    if (!(norm < std::numeric_limits<double>::infinity())) {
      costs.visual =
          norm;  // without the loss, because a bounded loss would hide an infinite residual
      return costs;
    }
  }
  for (int k = 0, last = -1; k < view.num_observations; ++k) {
    if (view.landmarks[k] == last) continue;
    last = view.landmarks[k];
    LinearizeAnchor(view, at, last, &costs.visual);
  }
  for (size_t i = 0; i < view.imu.size(); ++i) {
    if (view.imu[i] != nullptr) AddImuCost(view, states, static_cast<int>(i), &costs);
  }
  for (const WindowPrior& prior : view.priors) {
    costs.prior += CostOfPrior(view, prior, at);
  }
  return costs;
}

}  // namespace bundle
