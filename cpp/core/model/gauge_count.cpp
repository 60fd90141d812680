/// Degrees of freedom of the gauge: how many similarities of the world change no image, up to its
/// scale, and can be made by what is free.
///
/// A similarity is d = (a, b, s): X' = X + a + b x X + s X about the centre of the cameras. It has
/// to move every image with observations by local coordinates (factors/rig_pose.h)
///
///   phi = -R b,    tau = -R a + s t,
///
/// and no point that is held. Let u_f be the free unknowns of a frame (or of an image with a pose
/// of its own) and u_s those of all sensors that are refined. For all images i of a frame f,
///
///   M_f u_f = delta_i(d) - M_s u_s
///
/// has to have a solution. With W = P [delta_i, -M_s], P the projection onto what M_f does not
/// reach, those (d, u_s) that are possible are the null space of the W of all frames, one above the
/// other. Some may have d = 0: they move sensors on a rig against its frames. So the gauge has
///
///   nullity(W) - nullity(W without the columns of d)
///
/// degrees: 7 without rigs and nothing held, 6 where a fixed baseline gives the scale, 0 where two
/// images are held. Lengths are in units of the scene and columns in those of [delta_i, -M_s], so
/// that a baseline counts as one down to 1e-10 of the scene. Of W, the triangle of its QR
/// factorisation is kept.

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "core/dense/decompositions.h"
#include "core/factors/rig_pose.h"
#include "core/geometry/rotation.h"
#include "core/model/gauge.h"
#include "core/parallel/reducer.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Map6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;

constexpr double kZeroSingularValue = 1e-10;

class GaugeCount {
 public:
  GaugeCount(const ProblemView& problem, const FreeParameters& free)
      : problem_(problem), free_(free), first_column_(problem.num_sensors) {
    for (int s = 0; s < problem.num_sensors; ++s) {
      first_column_[s] = num_sensor_columns_;
      num_sensor_columns_ += __builtin_popcount(free.sensor[s]);
    }
    const int n = kNumGaugeDirections + num_sensor_columns_;
    // Rows are added until there are so many, and then factorised with the triangle above them.
    rows_ = MatrixXd::Zero(n + std::max(64, 4 * n), n);
    num_rows_ = n;
    squares_ = Eigen::VectorXd::Zero(n);
    const std::vector<uint8_t> observed = FindObservedImages(problem);
    for (int i = 0; i < problem.num_images; ++i) {
      if (observed[i]) images_.push_back(i);
    }
    FindScene();
  }

  int Degrees() {
    std::map<int, std::vector<int>> by_pose;  // images of each frame, or an image alone
    for (const int i : images_) by_pose[MovingPose(problem_, i)].push_back(i);
    for (const auto& [pose, images] : by_pose) AddImages(pose, images);
    const std::vector<int64_t> lengths = TrackLengths(problem_);
    std::vector<double> held;
    for (int point = 0; point < problem_.num_points; ++point) {
      const double* const at = problem_.points + 3 * int64_t{point};
      if (lengths[point] > 0 && free_.point[point] == 0) held.insert(held.end(), at, at + 3);
    }
    held = ConcatenateOverRanks(problem_.ranks, held);
    for (size_t k = 0; k < held.size(); k += 3) AddPoint(held.data() + k);
    Factorize();
    return Nullity(0) - (num_sensor_columns_ == 0 ? 0 : Nullity(kNumGaugeDirections));
  }

 private:
  void FindScene() {
    std::vector<Vector3d> centres;
    centre_.setZero();
    for (const int i : images_) {
      const PoseState pose = StartOf(i);
      centres.emplace_back(-Eigen::Map<const Matrix3>(pose.rotation).transpose() *
                           Eigen::Map<const Vector3d>(pose.translation));
      centre_ += centres.back() / static_cast<double>(images_.size());
    }
    double squared = 0;
    for (const Vector3d& centre : centres) squared += (centre - centre_).squaredNorm();
    if (squared == 0) squared = MaxOverRanks(problem_.ranks, SquaredDistanceOfSomePoint());
    size_ = squared > 0 ? std::sqrt(squared / static_cast<double>(images_.size())) : 1;
  }

  double SquaredDistanceOfSomePoint() const {
    double squared = 0;
    for (int64_t i = 0; i < problem_.num_observations && squared == 0; ++i) {
      const double* const point = problem_.points + 3 * int64_t{problem_.observation_point[i]};
      squared = (Eigen::Map<const Vector3d>(point) - centre_).squaredNorm();
    }
    return squared;
  }

  /// A pose at the start, about the origin of the world.
  PoseState StartOf(int pose) const {
    const double* const value = ValueOfPose(problem_, pose);
    PoseState state;
    QuaternionToRotation(value, state.rotation);
    std::copy_n(value + 4, 3, state.translation);
    std::copy_n(kIdentity3, 9, state.left_jacobian);
    return state;
  }

  /// A pose of the world about the centre of the cameras.
  PoseState Centred(int pose) const {
    PoseState state = StartOf(pose);
    double moved[3];
    MatrixVector3(state.rotation, centre_.data(), moved);
    for (int j = 0; j < 3; ++j) state.translation[j] += moved[j];
    return state;
  }

  /// The columns of a map that are free, with lengths in units of the scene.
  MatrixXd FreeColumns(Map6 map, uint8_t bits) const {
    map.bottomRows<3>() /= size_;
    map.rightCols<3>() *= size_;
    MatrixXd columns(6, __builtin_popcount(bits));
    int next = 0;
    for (int j = 0; j < kPoseSize; ++j) {
      if (bits >> j & 1u) columns.col(next++) = map.col(j);
    }
    return columns;
  }

  void AddImages(int pose, const std::vector<int>& images) {
    const bool is_frame = pose >= problem_.num_images;
    const uint8_t bits = is_frame ? free_.frame[pose - problem_.num_images] : free_.pose[pose];
    const PoseState own = Centred(pose);
    std::vector<int> columns;  // of rows_
    for (int k = 0; k < kNumGaugeDirections; ++k) columns.push_back(k);
    std::vector<int> sensors;
    for (const int i : images) {
      const int sensor = problem_.SensorOf(i);
      if (sensor < 0 || std::count(sensors.begin(), sensors.end(), sensor) > 0) continue;
      sensors.push_back(sensor);
      for (int k = 0; k < __builtin_popcount(free_.sensor[sensor]); ++k) {
        columns.push_back(kNumGaugeDirections + first_column_[sensor] + k);
      }
    }
    const auto rows = static_cast<Eigen::Index>(6 * images.size());
    MatrixXd wanted = MatrixXd::Zero(rows, static_cast<Eigen::Index>(columns.size()));
    MatrixXd reached(rows, __builtin_popcount(bits));
    for (size_t k = 0; k < images.size(); ++k) {
      const auto row = static_cast<Eigen::Index>(6 * k);
      const int sensor = problem_.SensorOf(images[k]);
      PoseState on_rig, image = own;
      Map6 map = Map6::Identity();
      if (is_frame) {
        RigPose rig = {&own, nullptr};
        if (sensor >= 0) {
          on_rig = StartOf(PoseOfSensor(problem_, sensor));
          rig.sensor = &on_rig;
          SensorMap(rig, map.data());
          const uint8_t free = free_.sensor[sensor];
          const auto at = std::find(columns.begin(), columns.end(),
                                    kNumGaugeDirections + first_column_[sensor]);
          if (free != 0) {
            wanted.block(row, at - columns.begin(), 6, __builtin_popcount(free)) =
                -FreeColumns(map, free);
          }
        }
        ComposePose(rig, &image);
        FrameMap(rig, map.data());
      }
      reached.middleRows<6>(row) = FreeColumns(map, bits);
      const Matrix3 rotation = Eigen::Map<const Matrix3>(image.rotation);
      wanted.block<3, 3>(row + 3, 0) = -rotation;
      wanted.block<3, 3>(row, 3) = -rotation;
      wanted.block<3, 1>(row + 3, 6) = Eigen::Map<const Vector3d>(image.translation) / size_;
    }
    Add(std::move(wanted), reached, columns);
  }

  void AddPoint(const double* point) {
    const Vector3d x = (Eigen::Map<const Vector3d>(point) - centre_) / size_;
    MatrixXd moves(3, kNumGaugeDirections);
    moves.leftCols<3>().setIdentity();
    for (int k = 0; k < 3; ++k) moves.col(3 + k) = Vector3d::Unit(k).cross(x);
    moves.col(6) = x;
    Add(std::move(moves), MatrixXd(3, 0), {0, 1, 2, 3, 4, 5, 6});
  }

  void Add(MatrixXd wanted, const MatrixXd& reached, const std::vector<int>& columns) {
    for (size_t j = 0; j < columns.size(); ++j) {
      squares_[columns[j]] += wanted.col(static_cast<Eigen::Index>(j)).squaredNorm();
    }
    if (reached.cols() > 0) {
      const MatrixXd q = OrthonormalColumns(reached);
      for (int twice = 0; twice < 2; ++twice) {
        wanted -= Multiply(q, MultiplyTransposed(q, wanted));
      }
    }
    for (Eigen::Index i = 0; i < wanted.rows(); ++i) {
      if (num_rows_ == rows_.rows()) Factorize();
      rows_.row(num_rows_).setZero();
      for (size_t j = 0; j < columns.size(); ++j) {
        rows_(num_rows_, columns[j]) = wanted(i, static_cast<Eigen::Index>(j));
      }
      ++num_rows_;
    }
  }

  void Factorize() {
    const Eigen::Index n = rows_.cols();
    rows_.topRows(n) = TriangleOfQr(rows_.topRows(num_rows_).eval());
    num_rows_ = n;
  }

  /// Of the columns from `first` on.
  int Nullity(int first) const {
    MatrixXd scaled = rows_.topRows(rows_.cols()).rightCols(rows_.cols() - first);
    for (Eigen::Index j = 0; j < scaled.cols(); ++j) {
      const double squared = squares_[first + j];
      if (squared > 0) scaled.col(j) /= std::sqrt(squared);
    }
    return static_cast<int>((SingularValues(scaled).array() < kZeroSingularValue).count());
  }

  const ProblemView& problem_;
  const FreeParameters& free_;
  std::vector<int> images_;  ///< with observations
  Vector3d centre_;
  double size_ = 1;
  std::vector<int> first_column_;  ///< of each sensor, behind those of d
  int num_sensor_columns_ = 0;
  MatrixXd rows_;  ///< W: a triangle, and rows below it up to num_rows_
  Eigen::Index num_rows_ = 0;
  Eigen::VectorXd squares_;  ///< of the columns before they are projected
};

}  // namespace

int CountGaugeDegrees(const ProblemView& problem, const FreeParameters& free) {
  return GaugeCount(problem, free).Degrees();
}

}  // namespace bundle
