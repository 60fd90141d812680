#include "core/window/window_gauge.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "core/dense/decompositions.h"
#include "core/geometry/rotation.h"

namespace bundle {
namespace {

/// Threshold of information along a direction, as a share of D^2. It is above the rounding errors
/// of a window and below the information of any prior.
constexpr double kKnown = 1e-11;

const double* StateOfJacobian(const WindowView& view, const WindowState& at, int i) {
  return view.anchored[i] != 0 ? view.anchors + kStateNumbers * i : at.state(i);
}

}  // namespace

WindowGauge::WindowGauge(const WindowView& view, const WindowState& at)
    : view_(view),
      at_(at),
      up_(Eigen::Map<const Eigen::Vector3d>(view.gravity.data())),
      centre_(Eigen::Vector3d::Zero()) {
  up_ = up_.norm() > 0 ? Eigen::Vector3d(-up_.normalized()) : Eigen::Vector3d::UnitZ();
  for (int i = 0; i < view.num_states; ++i) {
    centre_ += Eigen::Map<const Eigen::Vector3d>(StateOfJacobian(view, at, i) + 4);
  }
  centre_ /= std::max(view.num_states, 1);
}

WindowGauge::Rows WindowGauge::OfBlock(int block) const {
  Rows rows = Rows::Zero(PriorBlockSize(block, view_.num_states), kDegrees);
  if (block >= view_.camera_block()) return rows;
  const double* const state = StateOfJacobian(view_, at_, block / 2);
  if (block % 2 == 0) {
    Eigen::Matrix<double, 3, 3, Eigen::RowMajor> rotation;
    QuaternionToRotation(state, rotation.data());
    rows.block<3, 1>(0, 3) = rotation.transpose() * up_;
    rows.block<3, 3>(3, 0).setIdentity();
    rows.block<3, 1>(3, 3) = up_.cross(Eigen::Map<const Eigen::Vector3d>(state + 4) - centre_);
  } else {
    rows.block<3, 1>(0, 3) = up_.cross(Eigen::Map<const Eigen::Vector3d>(state + 7));
  }
  return rows;
}

Eigen::Matrix4d WindowGauge::Information(const WindowPrior& prior, const PriorForm& form) const {
  const auto n = static_cast<int>(form.gradient.size());
  Rows moves(n, kDegrees);
  int begin = 0;
  for (const int block : prior.blocks) {
    const Rows rows = OfBlock(block);
    moves.middleRows(begin, rows.rows()) = rows;
    begin += static_cast<int>(rows.rows());
  }
  const Eigen::Map<const Eigen::MatrixXd> lambda(form.information.data(), n, n);
  return moves.transpose() * (lambda * moves);
}

Eigen::Matrix<double, WindowGauge::kDegrees, Eigen::Dynamic> WindowGauge::Free(
    const Eigen::Matrix4d& square, const Eigen::Matrix4d& information) {
  // With U^T U = N^T D^2 N, the directions N U^-1 have unit length.
  const Eigen::Matrix4d root = InverseOfCholesky(square);
  const SymmetricEigen known = DecomposeSymmetric(root.transpose() * information * root);
  int free = 0;
  while (free < kDegrees && known.values[free] < kKnown) ++free;
  return root * known.vectors.leftCols(free);
}

}  // namespace bundle
