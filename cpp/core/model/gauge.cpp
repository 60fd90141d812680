#include "core/model/gauge.h"

/// The gauge.
///
/// Fixed by two cameras: pose numbers hold the free motions of the world (gauge_hold.cpp). If the
/// world is completely free, these numbers are the first pose and a coordinate of the translation
/// of a second pose. (COLMAP takes the largest coordinate of the inverse motion. Both fix the
/// gauge, so both reach the same cost.)
///
/// Fixed by three points: all nine coordinates of three points that are not on a line, as in
/// COLMAP. These are two numbers more than the gauge has: the shape of the triangle is fixed, too.
/// Points that are constant anyway are used first. The others are chosen far apart within the main
/// part of the cloud, so that no outlier becomes the reference. If rigs or constant images help to
/// fix the world, three points would fix even more degrees of freedom. The remaining motions are
/// then fixed as with two cameras.
///
/// Directions in which cameras and points can move together without a change of any image: the
/// world moves to X' = X + a, c + Exp(b) (X - c) or c + (1 + s) (X - c), with c the mean of the
/// projection centres. An image R X + t does not change, up to its scale, if
///
///   a:  R' = R,            t' = t - R a
///   b:  R' = R Exp(-b),    t' = t + (R - R') c          = t + R (b x c)   to first order
///   s:  R' = R,            t' = t + s (t + R c)
///
/// and R Exp(-b) = Exp(-R b) R is the change J_l(v) dw = -R b of the chart
/// (factors/reprojection.h). Intrinsics do not change. Columns that are not refined are left out,
/// so that a direction may not be an exact null vector of the system. Approximate null vectors are
/// enough for their use (linear/coarse_space.h).

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>
#include <vector>

#include "core/error.h"
#include "core/geometry/rotation.h"
#include "core/model/gauge_count.h"
#include "core/model/gauge_hold.h"
#include "core/sums/communicator.h"

namespace bundle {

namespace {

/// The indices that are marked, ascending.
std::vector<int> Marked(const std::vector<uint8_t>& marks) {
  std::vector<int> indices;
  for (size_t i = 0; i < marks.size(); ++i) {
    if (marks[i]) indices.push_back(static_cast<int>(i));
  }
  return indices;
}

std::vector<int> ObservedPoints(const AdjustmentProblem& problem) {
  std::vector<uint8_t> observed(problem.num_points);
  for (int64_t i = 0; i < problem.num_observations; ++i) observed[problem.observation_point[i]] = 1;
  return Marked(observed);
}

/// Squared distance of point p from point a, or from the line through a and b if b >= 0.
double SquaredDistance(const AdjustmentProblem& problem, int p, int a, int b) {
  const double* origin = problem.points + 3 * static_cast<int64_t>(a);
  const double* point = problem.points + 3 * static_cast<int64_t>(p);
  const double to_point[] = {point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]};
  const auto squared = [](const double* v) { return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]; };
  if (b < 0) return squared(to_point);
  const double* end = problem.points + 3 * static_cast<int64_t>(b);
  const double along[] = {end[0] - origin[0], end[1] - origin[1], end[2] - origin[2]};
  double area[3];
  Cross3(along, to_point, area);
  return squared(area) / squared(along);
}

/// Points whose distance from the median of the cloud is at most twice the median distance.
std::vector<int> BulkOfThePoints(const AdjustmentProblem& problem, const std::vector<int>& points) {
  const auto median = [](std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
    return values[values.size() / 2];
  };
  double center[3];
  std::vector<double> values(points.size());
  for (int axis = 0; axis < 3; ++axis) {
    for (size_t i = 0; i < points.size(); ++i) {
      values[i] = problem.points[3 * static_cast<int64_t>(points[i]) + axis];
    }
    center[axis] = median(values);
  }
  for (size_t i = 0; i < points.size(); ++i) {
    const double* point = problem.points + 3 * static_cast<int64_t>(points[i]);
    values[i] = std::hypot(point[0] - center[0], point[1] - center[1], point[2] - center[2]);
  }
  const double limit = 2 * median(values);
  std::vector<int> bulk;
  for (size_t i = 0; i < points.size(); ++i) {
    if (values[i] <= limit) bulk.push_back(points[i]);
  }
  return bulk;
}

/// Finds the point that is furthest from the chosen ones, by more than `least`, a squared distance;
/// -1: no such point.
int Furthest(const AdjustmentProblem& problem, const std::vector<int>& points, const int chosen[3],
             int count, double* least) {
  int furthest = -1;
  for (const int p : points) {
    const double distance =
        count == 0 ? 1 : SquaredDistance(problem, p, chosen[0], count == 1 ? -1 : chosen[1]);
    if (distance > *least) *least = distance, furthest = p;
  }
  return furthest;
}

/// A third constant point would fix all of the world.
std::string FixThreePoints(const AdjustmentProblem& problem, const std::vector<int>& points,
                           FreeParameters* free) {
  constexpr double kFar = 1e-12;  // squared, relative to the bulk
  std::vector<int> held;
  std::copy_if(points.begin(), points.end(), std::back_inserter(held),
               [free](int p) { return free->point[p] == 0; });
  const std::vector<int> bulk = BulkOfThePoints(problem, points);
  int chosen[3] = {-1, -1, -1};
  for (int k = 0; k < 3; ++k) {
    double most = 0;
    chosen[k] = Furthest(problem, bulk, chosen, k, &most);
    double least = kFar * most;
    const int of_held = k == 2 ? -1 : Furthest(problem, held, chosen, k, &least);
    if (of_held >= 0) chosen[k] = of_held;
    if (chosen[k] < 0) return "Gauge three_points fixes nothing: no three points span a plane.";
  }
  for (const int p : chosen) free->point[p] = 0;
  return "";
}

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

/// True if an observed image, or a rig, helps to fix the world.
bool PosesHoldSomething(const AdjustmentProblem& problem, const std::vector<int>& images,
                        const FreeParameters& free) {
  return problem.num_frames > 0 || std::any_of(images.begin(), images.end(), [&](int image) {
           return free.pose[image] != FreeParameters::kWholePose;
         });
}

}  // namespace

std::string FixGauge(const AdjustmentProblem& problem, Gauge gauge, FreeParameters* free) {
  if (gauge == Gauge::kNone) return "";
  const std::vector<int> images = Marked(FindObservedImages(problem));
  if (images.empty()) return "";
  if (gauge == Gauge::kTwoCameras) return HoldFreeMotions(problem, free);
  if (CountGaugeDegrees(problem, *free) == 0) return "";
  if (PosesHoldSomething(problem, images, *free)) {
    const std::string sentence = HoldFreeMotions(problem, free);
    if (!sentence.empty()) return sentence;
    return "Gauge two_cameras was used instead of three_points: rigs or constant images fix a part "
           "of "
           "the gauge, and three points would also fix the shape of their triangle.";
  }
  if (problem.division.communicator != nullptr) {
    throw InputError(
        "gauge: expected two_cameras or none with several processes, found "
        "three_points");
  }
  return FixThreePoints(problem, ObservedPoints(problem), free);
}

void GaugeRowsOfPose(const PoseState& pose, const double centre[3],
                     double rows[kPoseSize * kNumGaugeDirections]) {
  const Matrix3 rotation = Eigen::Map<const Matrix3>(pose.rotation);
  const Eigen::Vector3d translation = Eigen::Map<const Eigen::Vector3d>(pose.translation);
  const Matrix3 left_jacobian = Eigen::Map<const Matrix3>(pose.left_jacobian);
  const Eigen::Vector3d c = Eigen::Map<const Eigen::Vector3d>(centre);
  Eigen::Map<Eigen::Matrix<double, kPoseSize, kNumGaugeDirections, Eigen::RowMajor>> out(rows);
  out.setZero();
  out.block<3, 3>(3, 0) = -rotation;
  out.block<3, 3>(0, 3) = -left_jacobian.inverse() * rotation;
  for (int k = 0; k < 3; ++k) {
    out.block<3, 1>(3, 3 + k) = rotation * Eigen::Vector3d::Unit(k).cross(c);
  }
  out.block<3, 1>(3, 6) = translation + rotation * c;
}

void GaugeRowsOfPoint(const double point[3], const double centre[3],
                      double rows[3 * kNumGaugeDirections]) {
  const double arm[3] = {point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]};
  for (int k = 0; k < 3; ++k) {
    double axis[3] = {0, 0, 0}, turned[3];
    axis[k] = 1;
    Cross3(axis, arm, turned);
    for (int i = 0; i < 3; ++i) {
      rows[kNumGaugeDirections * i + k] = axis[i];
      rows[kNumGaugeDirections * i + 3 + k] = turned[i];
    }
    rows[kNumGaugeDirections * k + 6] = arm[k];
  }
}

std::array<double, 3> MeanCentre(const CameraStates& cameras, int num_images) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int i = 0; i < num_images; ++i) {
    const PoseState& pose = cameras.pose(i);
    sum -= Eigen::Map<const Matrix3>(pose.rotation).transpose() *
           Eigen::Map<const Eigen::Vector3d>(pose.translation);
  }
  if (num_images > 0) sum /= num_images;
  return {sum[0], sum[1], sum[2]};
}

std::vector<double> GaugeDirections(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                    const CameraStates& cameras) {
  return GaugeDirections(problem, layout, cameras, MeanCentre(cameras, problem.num_images).data());
}

std::vector<double> GaugeDirections(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                    const CameraStates& cameras, const double centre[3]) {
  constexpr int kCount = kNumGaugeDirections;
  std::vector<double> gauge_directions(static_cast<size_t>(layout.state_size()) * kCount, 0.0);
  // The velocities of twists scale with the world.
  // The scaling of the world is not used as a direction of a sensor. A sensor's block is better as
  // a cluster of its own that has all its columns (linear/coarse_space.cpp).
  for (int i = 0; i < problem.num_images + problem.num_frames; ++i) {
    if (layout.pose_block(i) < 0) continue;
    const CameraBlock& block = layout.blocks()[layout.pose_block(i)];
    double rows[kPoseSize * kCount];
    GaugeRowsOfPose(cameras.pose(i), centre, rows);
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      double* const to = &gauge_directions[static_cast<size_t>(block.offset + k) * kCount];
      if (column >= kFirstTwist + 3) to[6] = cameras.twist(i)[column - kFirstTwist];
      for (int m = 0; m < kCount && column < kPoseSize; ++m) to[m] = rows[column * kCount + m];
    }
  }
  for (const int p : layout.kept_points()) {
    const size_t first = layout.blocks()[layout.kept_block(p)].offset;
    GaugeRowsOfPoint(problem.points + 3 * int64_t{p}, centre, &gauge_directions[first * kCount]);
  }
  return gauge_directions;
}

}  // namespace bundle
