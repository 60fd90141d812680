/// The gauge.
///
/// Fixed by two cameras: the first pose is fixed (six degrees), and of the second one coordinate of
/// its translation. Scaling the world by s about the first camera moves a second camera's
/// translation by t_2 -> t_2 + (s - 1) t_21, where t_21 is the translation of cam2_from_cam1.
/// Holding the coordinate in which t_21 is largest therefore holds the scale best. (COLMAP takes
/// the largest coordinate of the inverse motion; both hold the gauge, so both reach the same cost.)
/// The second camera is the first after it, in the order of images, that stands elsewhere, as in
/// COLMAP.
///
/// Fixed by three points: all nine coordinates of three points that are not on a line, as COLMAP
/// does. That is two more than the gauge has: the shape of their triangle does not change any more.
/// They are taken far apart but from the bulk of the cloud, so that no stray point becomes the
/// reference.
///
/// Problems with rigs have as many degrees as are counted: six where the baseline of a rig is
/// fixed, which gives the scale. The first frame (or image with a pose of its own) takes six, and a
/// coordinate of the second one's translation the scale, if it is left; where there is no second
/// one, a coordinate of a sensor's translation does. Three points would take more than that, so
/// they are not taken.
///
/// Its directions, in which cameras and points may move together without any image changing: the
/// world goes to X' = X + a, c + Exp(b) (X - c) or c + (1 + s) (X - c), with c the mean of the
/// projection centres. An image R X + t stays what it is, up to its scale, if
///
///   a:  R' = R,            t' = t - R a
///   b:  R' = R Exp(-b),    t' = t + (R - R') c          = t + R (b x c)   to first order
///   s:  R' = R,            t' = t + s (t + R c)
///
/// and R Exp(-b) = Exp(-R b) R is the change J_l(v) dw = -R b of the chart
/// (factors/reprojection.h). Intrinsics stay as they are. Columns that are not refined are left
/// out, so that a direction may not be an exact null vector of the system; near ones are enough for
/// its use (linear/coarse_space.h).

#include "core/model/gauge.h"

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
#include "core/parallel/reducer.h"

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

std::vector<int> ObservedPoints(const ProblemView& problem) {
  std::vector<uint8_t> observed(problem.num_points);
  for (int64_t i = 0; i < problem.num_observations; ++i) observed[problem.observation_point[i]] = 1;
  return Marked(observed);
}

/// Those of `indices` where nothing is free.
std::vector<int> Fixed(const std::vector<int>& indices, const std::vector<uint8_t>& free) {
  std::vector<int> fixed;
  std::copy_if(indices.begin(), indices.end(), std::back_inserter(fixed),
               [&free](int i) { return free[i] == 0; });
  return fixed;
}

/// The translation of pose b * inverse(pose a), that is t_b - R_b R_a^T t_a.
void RelativeTranslation(const ProblemView& problem, int a, int b, double translation[3]) {
  const double* pose_a = ValueOfPose(problem, a);
  const double* pose_b = ValueOfPose(problem, b);
  double rotation_a[9], rotation_b[9], minus_center_a[3];
  QuaternionToRotation(pose_a, rotation_a);
  QuaternionToRotation(pose_b, rotation_b);
  VectorMatrix3(pose_a + 4, rotation_a, minus_center_a);
  MatrixVector3(rotation_b, minus_center_a, translation);
  for (int i = 0; i < 3; ++i) translation[i] = pose_b[4 + i] - translation[i];
}

std::string FixTwoCameras(const ProblemView& problem, const std::vector<int>& images,
                          const std::vector<int>& fixed, FreeParameters* free) {
  const int first = fixed.empty() ? images.front() : fixed.front();
  free->pose[first] = 0;
  for (const int second : images) {
    if (second == first) continue;
    double baseline[3];
    RelativeTranslation(problem, first, second, baseline);
    int largest = 0;
    for (int i = 1; i < 3; ++i) {
      if (std::abs(baseline[i]) > std::abs(baseline[largest])) largest = i;
    }
    if (std::abs(baseline[largest]) > 1e-9) {
      free->pose[second] = static_cast<uint8_t>(free->pose[second] & ~(1u << (3 + largest)));
      return "";
    }
  }
  return "Gauge two_cameras holds only one image: no second image stands elsewhere, so the scale "
         "is free.";
}

/// Squared distance of point p from point a, or from the line through a and b if b >= 0.
double SquaredDistance(const ProblemView& problem, int p, int a, int b) {
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

/// Points no further from the median of the cloud than twice the median distance.
std::vector<int> BulkOfThePoints(const ProblemView& problem, const std::vector<int>& points) {
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

std::string FixThreePoints(const ProblemView& problem, const std::vector<int>& points,
                           FreeParameters* free) {
  int chosen[3] = {-1, -1, -1};
  const std::vector<int> bulk = BulkOfThePoints(problem, points);
  chosen[0] = bulk.front();
  for (int k = 1; k < 3 && chosen[k - 1] >= 0; ++k) {
    double furthest = 0;
    for (const int p : bulk) {
      const double distance = SquaredDistance(problem, p, chosen[0], k == 1 ? -1 : chosen[1]);
      if (distance > furthest) furthest = distance, chosen[k] = p;
    }
  }
  if (chosen[2] < 0) return "Gauge three_points is not held: no three points span a plane.";
  for (const int p : chosen) free->point[p] = 0;
  return "";
}

using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

/// Holds the free coordinate of a pose's translation in which `direction` is largest. False where
/// it is zero in all of them.
bool HoldCoordinate(const double* direction, uint8_t* bits) {
  int largest = -1;
  for (int j = 0; j < 3; ++j) {
    if ((*bits >> (3 + j) & 1) == 0 || !(std::abs(direction[j]) > 1e-9)) continue;
    if (largest < 0 || std::abs(direction[j]) > std::abs(direction[largest])) largest = j;
  }
  if (largest < 0) return false;
  *bits = static_cast<uint8_t>(*bits & ~(1u << (3 + largest)));
  return true;
}

std::string FixGaugeOfRigs(const ProblemView& problem, const std::vector<int>& images,
                           FreeParameters* free) {
  std::vector<int> poses;  // of frames, and of images that have one
  for (const int i : images) poses.push_back(MovingPose(problem, i));
  const auto bits = [&](int pose) -> uint8_t& { return free->OfPose(pose); };
  int degrees = CountGaugeDegrees(problem, *free);
  if (degrees == 0) return "";
  const auto held = std::find_if(poses.begin(), poses.end(), [&](int p) { return bits(p) == 0; });
  const int first = held != poses.end() ? *held : poses.front();
  if (degrees > 1) {
    bits(first) = 0;
    degrees = CountGaugeDegrees(problem, *free);
  }
  if (degrees == 0) return "";
  for (const int second : poses) {
    double baseline[3];
    RelativeTranslation(problem, first, second, baseline);
    if (second != first && HoldCoordinate(baseline, &bits(second))) return "";
  }
  for (int s = 0; s < problem.num_sensors; ++s) {
    const int pose = PoseOfSensor(problem, s);
    if (HoldCoordinate(ValueOfPose(problem, pose) + 4, &bits(pose))) return "";
  }
  return "The gauge holds only one frame: nothing that is free stands elsewhere, so the scale is "
         "free.";
}

}  // namespace

std::string FixGauge(const ProblemView& problem, Gauge gauge, FreeParameters* free) {
  if (gauge == Gauge::kNone) return "";
  const std::vector<int> images = Marked(FindObservedImages(problem));
  if (problem.num_frames > 0) {
    if (images.empty()) return "";
    const std::string sentence = FixGaugeOfRigs(problem, images, free);
    if (gauge == Gauge::kTwoCameras || !sentence.empty()) return sentence;
    return "Gauge three_points is held as two_cameras, by a frame: three points would hold the "
           "shape of their triangle as well, which rigs do not leave free.";
  }
  const std::vector<int> points = ObservedPoints(problem);
  const std::vector<int> fixed_images = Fixed(images, free->pose);
  const auto num_points = SumOverRanks(problem.ranks, static_cast<int64_t>(points.size()));
  const auto num_fixed_points =
      SumOverRanks(problem.ranks, static_cast<int64_t>(Fixed(points, free->point).size()));
  const bool held = fixed_images.size() >= 2 || fixed_images.size() == images.size() ||
                    num_fixed_points >= 3 || num_fixed_points == num_points;
  if (held) return "";
  if (gauge == Gauge::kTwoCameras) return FixTwoCameras(problem, images, fixed_images, free);
  if (problem.ranks != nullptr) {
    throw InputError(
        "gauge: expected two_cameras or none with several processes, found "
        "three_points");
  }
  return FixThreePoints(problem, points, free);
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

std::vector<double> GaugeDirections(const ProblemView& problem, const ParameterLayout& layout,
                                    const CameraStates& cameras) {
  constexpr int kCount = kNumGaugeDirections;
  std::vector<double> gauge_directions(static_cast<size_t>(layout.state_size()) * kCount, 0.0);
  const std::array<double, 3> centre = MeanCentre(cameras, problem.num_images);
  // What scaling the world does to a sensor is no direction of it: a sensor's block is better off
  // without, as a cluster of its own that has all its columns (linear/coarse_space.cpp).
  for (int i = 0; i < problem.num_images + problem.num_frames; ++i) {
    if (layout.pose_block(i) < 0) continue;
    const CameraBlock& block = layout.blocks()[layout.pose_block(i)];
    double rows[kPoseSize * kCount];
    GaugeRowsOfPose(cameras.pose(i), centre.data(), rows);
    for (int k = 0; k < block.size; ++k) {
      if (block.columns[k] >= kPoseSize) break;
      double* const to = &gauge_directions[static_cast<size_t>(block.offset + k) * kCount];
      for (int m = 0; m < kCount; ++m) to[m] = rows[block.columns[k] * kCount + m];
    }
  }
  return gauge_directions;
}

}  // namespace bundle
