#include "core/model/gauge_count.h"

/// Degrees of freedom of the gauge: the number of similarities of the world that change no image,
/// up to its scale, and that the free parameters can perform.
///
/// A similarity is d = (a, b, s): X' = X + a + b x X + s X about the centre of the cameras. It must
/// move every image with observations by local coordinates (factors/rig_pose.h)
///
///   phi = -R b,    tau = -R a + s t,
///
/// and move no constant point. Let u_f be the free unknowns of a frame (or of an image with a pose
/// of its own) and u_s those of all refined sensors. For all images i of a frame f,
///
///   M_f u_f = delta_i(d) - M_s u_s
///
/// must have a solution. Let W = P [delta_i, -M_s], with P the projection onto the orthogonal
/// complement of the range of M_f. The possible (d, u_s) are the null space of the stacked W of all
/// frames. Some may have d = 0: they move sensors on a rig against its frames. So the gauge has
///
///   nullity(W) - nullity(W without the columns of d)
///
/// degrees: 7 without rigs and constant parameters, 6 if a constant baseline gives the scale, 4 if
/// one point is constant, 0 if two images are. Lengths are in units of the scene and columns in
/// those of [delta_i, -M_s], so that baselines down to 1e-10 of the scene count. Only the triangle
/// of the QR factorisation of W is kept. A free frame of one image reaches every direction and has
/// no rows. Constant points need three rows each, in units of their distance if they are far. But a
/// similarity that fixes two points fixes their line, and a similarity that fixes three points
/// fixes the world: three points that are far apart represent all.
///
/// A pose is refined by (w, t) with t about the origin of the problem. About the centre c of the
/// cameras it is t_c = t + R c. A rotation with constant t moves t_c by phi x R c. If an image
/// turns about its own centre, its translation follows by phi x t_c.

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "core/dense/decompositions.h"
#include "core/geometry/rotation.h"
#include "core/model/gauge.h"
#include "core/model/parameter_layout.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Map6 = Eigen::Matrix<double, 6, 6>;
using RowMajor6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;

constexpr double kZeroSingularValue = 1e-10;

/// Selects up to three of the points (three numbers each) with the same span as all of them.
std::vector<double> Spanning(const std::vector<double>& points) {
  std::vector<double> chosen;
  const auto at = [](const std::vector<double>& of, size_t k) {
    return Eigen::Map<const Vector3d>(&of[k]);
  };
  for (int count = 0; count < 3; ++count) {
    double furthest = count == 0 ? -1 : 0;
    size_t next = points.size();
    for (size_t k = 0; k < points.size(); k += 3) {
      double squared = 0;
      if (count > 0) {
        Vector3d from_first = at(points, k) - at(chosen, 0);
        if (count == 2) {
          const Vector3d along = (at(chosen, 3) - at(chosen, 0)).normalized();
          from_first -= from_first.dot(along) * along;
        }
        squared = from_first.squaredNorm();
      }
      if (squared > furthest) furthest = squared, next = k;
    }
    if (next == points.size()) break;
    chosen.insert(chosen.end(), &points[next], &points[next] + 3);
  }
  return chosen;
}

}  // namespace

FreeMotions::FreeMotions(const AdjustmentProblem& problem, const FreeParameters& free)
    : problem_(problem), free_(free), first_column_(problem.num_sensors) {
  for (int s = 0; s < problem.num_sensors; ++s) {
    first_column_[s] = num_sensor_columns_;
    num_sensor_columns_ += __builtin_popcount(free.sensor[s]);
  }
  const int n = kNumGaugeDirections + num_sensor_columns_;
  // Rows are collected up to this number, and then factorised with the triangle above them.
  rows_ = MatrixXd::Zero(n + std::max(64, 4 * n), n);
  num_rows_ = n;
  squares_ = Eigen::VectorXd::Zero(n);
  const std::vector<uint8_t> observed = FindObservedImages(problem);
  std::vector<int> place(NumPoses(problem), -1);
  for (int i = 0; i < problem.num_images; ++i) {
    if (!observed[i]) continue;
    images_.push_back(i);
    int& at = place[MovingPose(problem, i)];
    if (at < 0) {
      at = static_cast<int>(poses_.size());
      poses_.push_back(MovingPose(problem, i));
      moving_.emplace_back();
    }
    moving_[at].push_back(i);
  }
  FindScene();
  for (size_t k = 0; k < poses_.size(); ++k) AddImages(poses_[k], moving_[k]);
  AddHeldPoints();
  Factorize();
}

int FreeMotions::Degrees() const {
  const auto nullity = [&](int first) {
    return (SingularValues(Scaled(first)).array() < kZeroSingularValue).count();
  };
  return static_cast<int>(nullity(0) -
                          (num_sensor_columns_ == 0 ? 0 : nullity(kNumGaugeDirections)));
}

MatrixXd FreeMotions::Basis() const {
  const RightSingularVectors singular = DecomposeSingular(Scaled(0));
  const auto nullity = (singular.values.array() < kZeroSingularValue).count();
  MatrixXd basis = singular.vectors.rightCols(nullity);
  for (Eigen::Index j = 0; j < squares_.size(); ++j) {
    if (squares_[j] > 0) basis.row(j) /= std::sqrt(squares_[j]);
  }
  return nullity == 0 ? basis : OrthonormalColumns(basis);
}

std::vector<int> FreeMotions::Poses() const {
  std::vector<int> poses = poses_;
  for (int s = 0; s < problem_.num_sensors; ++s) {
    if (free_.sensor[s] != 0) poses.push_back(PoseOfSensor(problem_, s));
  }
  return poses;
}

FreeMotions::PoseMoves FreeMotions::MovesOf(int pose, const MatrixXd& motions) const {
  const int sensor = pose - problem_.num_images - problem_.num_frames;
  PoseMoves moves;
  if (sensor >= 0) {
    moves.centered = MatrixXd::Zero(kPoseSize, motions.cols());
    int column = kNumGaugeDirections + first_column_[sensor];
    for (int j = 0; j < kPoseSize; ++j) {
      if (free_.sensor[sensor] >> j & 1u) moves.centered.row(j) = motions.row(column++);
    }
    moves.chart = moves.centered;
    return moves;
  }
  // The images of a frame give the same motion, so that the first of them is sufficient.
  const auto place = std::find(poses_.begin(), poses_.end(), pose) - poses_.begin();
  const int image = moving_[place].front();
  const PoseState own = Centered(pose);
  const Equations of = EquationsOf(pose, {image});
  moves.centered = MatrixXd::Zero(kPoseSize, motions.cols());
  for (size_t k = 0; k < of.columns.size(); ++k) {
    moves.centered += of.wanted.col(static_cast<Eigen::Index>(k)) * motions.row(of.columns[k]);
  }
  if (problem_.SensorOf(image) >= 0 && pose >= problem_.num_images) {
    const PoseState on_rig = StartOf(PoseOfSensor(problem_, problem_.SensorOf(image)));
    const Matrix3 back = Eigen::Map<const Matrix3>(on_rig.rotation).transpose();
    moves.centered.topRows<3>() = (back * moves.centered.topRows<3>()).eval();
    moves.centered.bottomRows<3>() = (back * moves.centered.bottomRows<3>()).eval();
  }
  moves.chart = moves.centered;
  const Matrix3 by_turn = ChartMap(pose, own).bottomLeftCorner<3, 3>() / size_;
  moves.chart.bottomRows<3>() -= by_turn * moves.centered.topRows<3>();
  return moves;
}

void FreeMotions::FindScene() {
  std::vector<Vector3d> centres;
  centre_.setZero();
  for (const int i : images_) {
    const PoseState pose = StartOf(i);
    centres.emplace_back(-Eigen::Map<const Matrix3>(pose.rotation).transpose() *
                         Eigen::Map<const Vector3d>(pose.translation));
    centre_ += centres.back() / static_cast<double>(images_.size());
  }
  // The root mean square, without overflow of squares at 1e200.
  double most = 0, squares = 0;
  for (const Vector3d& centre : centres) {
    most = std::max(most, (centre - centre_).cwiseAbs().maxCoeff());
  }
  for (const Vector3d& centre : centres) {
    if (most > 0) squares += ((centre - centre_) / most).squaredNorm();
  }
  size_ = most > 0 ? most * std::sqrt(squares / static_cast<double>(images_.size()))
                   : MaxOverRanks(problem_.division.communicator, DistanceOfSomePoint());
  if (!(size_ > 0 && std::isfinite(size_))) size_ = 1;
}

double FreeMotions::DistanceOfSomePoint() const {
  double distance = 0;
  for (int64_t i = 0; i < problem_.num_observations && distance == 0; ++i) {
    const double* const point = problem_.points + 3 * int64_t{problem_.observation_point[i]};
    distance = (Eigen::Map<const Vector3d>(point) - centre_).stableNorm();
  }
  return distance;
}

void FreeMotions::AddImages(int pose, const std::vector<int>& images) {
  const uint8_t bits = BitsOf(pose);
  Equations of = EquationsOf(pose, images);
  for (size_t j = 0; j < of.columns.size(); ++j) {
    squares_[of.columns[j]] += of.wanted.col(static_cast<Eigen::Index>(j)).squaredNorm();
  }
  longest_move_ = std::max(longest_move_, of.wanted.topRows<6>().norm());
  if (images.size() == 1 && bits == FreeParameters::kWholePose) return;
  const PoseState own = Centered(pose);
  const Map6 chart = ChartMap(pose, own);
  MatrixXd reached(of.wanted.rows(), __builtin_popcount(bits));
  for (size_t k = 0; k < images.size(); ++k) {
    Map6 map = chart;
    if (pose >= problem_.num_images) {
      PoseState on_rig;
      RowMajor6 by_frame;
      FrameMap(OnRig(images[k], own, &on_rig), by_frame.data());
      map = (by_frame * chart).eval();
    }
    reached.middleRows<6>(static_cast<Eigen::Index>(6 * k)) = FreeColumns(map, bits);
  }
  if (reached.cols() > 0) {
    const MatrixXd q = OrthonormalColumns(reached);
    for (int twice = 0; twice < 2; ++twice) {
      of.wanted -= Multiply(q, MultiplyTransposed(q, of.wanted));
    }
  }
  Add(of.wanted, of.columns);
}

void FreeMotions::AddHeldPoints() {
  std::vector<double> held;
  if (std::count(free_.point.begin(), free_.point.end(), 0) > 0) {
    const LargeVector<int64_t> lengths = TrackLengths(problem_);
    for (int point = 0; point < problem_.num_points; ++point) {
      const double* const at = problem_.points + 3 * int64_t{point};
      if (lengths[point] > 0 && free_.point[point] == 0) held.insert(held.end(), at, at + 3);
    }
  }
  held = Spanning(ConcatenateOverRanks(problem_.division.communicator, Spanning(held)));
  for (size_t k = 0; k < held.size(); k += 3) {
    Vector3d x = (Eigen::Map<const Vector3d>(&held[k]) - centre_) / size_;
    const double unit = std::max(1.0, x.stableNorm());
    x /= unit;
    MatrixXd moves(3, kNumGaugeDirections);
    moves.leftCols<3>() = Matrix3::Identity() / unit;
    for (int j = 0; j < 3; ++j) moves.col(3 + j) = Vector3d::Unit(j).cross(x);
    moves.col(6) = x;
    squares_.head<kNumGaugeDirections>() += moves.colwise().squaredNorm().transpose();
    Add(moves, {0, 1, 2, 3, 4, 5, 6});
  }
}

void FreeMotions::Add(const MatrixXd& rows, const std::vector<int>& columns) {
  for (Eigen::Index i = 0; i < rows.rows(); ++i) {
    if (num_rows_ == rows_.rows()) Factorize();
    rows_.row(num_rows_).setZero();
    for (size_t j = 0; j < columns.size(); ++j) {
      rows_(num_rows_, columns[j]) = rows(i, static_cast<Eigen::Index>(j));
    }
    ++num_rows_;
  }
}

void FreeMotions::Factorize() {
  const Eigen::Index n = rows_.cols();
  rows_.topRows(n) = TriangleOfQr(rows_.topRows(num_rows_).eval());
  num_rows_ = n;
}

/// The triangle, from column `first` on, scaled so that columns have norm 1 before the projection.
MatrixXd FreeMotions::Scaled(int first) const {
  MatrixXd scaled = rows_.topRows(rows_.cols()).rightCols(rows_.cols() - first);
  for (Eigen::Index j = 0; j < scaled.cols(); ++j) {
    const double squared = squares_[first + j];
    if (squared > 0) scaled.col(j) /= std::sqrt(squared);
  }
  return scaled;
}

int CountGaugeDegrees(const AdjustmentProblem& problem, const FreeParameters& free) {
  return FreeMotions(problem, free).Degrees();
}

}  // namespace bundle
