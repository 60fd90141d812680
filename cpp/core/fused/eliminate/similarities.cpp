/// The directions in which cameras and points may move together without any image changing.
///
/// The world goes to X' = X + a, c + Exp(b) (X - c) or c + (1 + s) (X - c), with c the mean of the
/// projection centres. An image R X + t stays what it is, up to its scale, if
///
///   a:  R' = R,            t' = t - R a
///   b:  R' = R Exp(-b),    t' = t + (R - R') c          = t + R (b x c)   to first order
///   s:  R' = R,            t' = t + s (t + R c)
///
/// and R Exp(-b) = Exp(-R b) R is the change J_l(w) dw = -R b of the chart
/// (residuals/reprojection.h). Intrinsics stay as they are. Columns that are not refined are left
/// out, so with some of them a similarity is none for the system any more; near ones are what they
/// are used for.

#include "core/fused/eliminate/similarities.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <cstddef>

#include "core/fused/reduced/reduced_system.h"

namespace bundle::fused {
namespace {

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using PoseRows = Eigen::Matrix<double, kPoseSize, ReducedSystem::kNumSimilarities>;

Eigen::Vector3d MeanCentre(const CameraStates& cameras, int num_images) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int i = 0; i < num_images; ++i) {
    const PoseState& pose = cameras.pose(i);
    sum -= Eigen::Map<const Matrix3>(pose.rotation).transpose() *
           Eigen::Map<const Eigen::Vector3d>(pose.translation);
  }
  return num_images == 0 ? sum : Eigen::Vector3d(sum / num_images);
}

PoseRows OfPose(const PoseState& pose, const Eigen::Vector3d& centre) {
  const Matrix3 rotation = Eigen::Map<const Matrix3>(pose.rotation);
  const Eigen::Vector3d translation = Eigen::Map<const Eigen::Vector3d>(pose.translation);
  const Matrix3 left_jacobian = Eigen::Map<const Matrix3>(pose.left_jacobian);
  PoseRows rows = PoseRows::Zero();
  rows.block<3, 3>(3, 0) = -rotation;
  rows.block<3, 3>(0, 3) = -left_jacobian.inverse() * rotation;
  for (int k = 0; k < 3; ++k) {
    rows.block<3, 1>(3, 3 + k) = rotation * Eigen::Vector3d::Unit(k).cross(centre);
  }
  rows.block<3, 1>(3, 6) = translation + rotation * centre;
  return rows;
}

}  // namespace

std::vector<double> Similarities(const ProblemView& problem, const ParameterLayout& layout,
                                 const CameraStates& cameras) {
  constexpr int kCount = ReducedSystem::kNumSimilarities;
  std::vector<double> similarities(static_cast<size_t>(layout.state_size()) * kCount, 0.0);
  const Eigen::Vector3d centre = MeanCentre(cameras, problem.num_images);
  for (int i = 0; i < problem.num_images; ++i) {
    if (layout.image_block(i) < 0) continue;
    const CameraSideBlock& block = layout.blocks()[layout.image_block(i)];
    const PoseRows rows = OfPose(cameras.pose(i), centre);
    for (int k = 0; k < block.size; ++k) {
      if (block.columns[k] >= kPoseSize) break;
      double* const to = &similarities[static_cast<size_t>(block.offset + k) * kCount];
      for (int m = 0; m < kCount; ++m) to[m] = rows(block.columns[k], m);
    }
  }
  return similarities;
}

}  // namespace bundle::fused
