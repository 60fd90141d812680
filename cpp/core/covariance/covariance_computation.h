#pragma once

/// One computation of covariances, step by step (covariance.h has the mathematics).

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/covariance/covariance.h"
#include "core/covariance/free_gauge.h"
#include "core/covariance/long_scatter.h"
#include "core/covariance/long_sums.h"
#include "core/covariance/point_pairs.h"
#include "core/covariance/reduced_system.h"
#include "core/covariance/sandwich.h"
#include "core/error.h"
#include "core/geometry/rotation.h"
#include "core/model/scene_frame.h"
#include "core/model/unknown_names.h"

namespace bundle {

enum class Deletions;  // influence.h
struct InfluenceOptions;
struct InfluenceOutput;
struct ReliabilityOptions;  // reliability.h
struct ReliabilityOutput;

class CovarianceComputation {
  friend class AdjointComputation;  // adjoint.cpp

 public:
  using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  using Matrix6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
  using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  using Vector3 = Eigen::Vector3d;

  CovarianceComputation(const AdjustmentProblem& problem, const SolveOptions& options,
                        const CovarianceOptions& wanted)
      : frame_(problem),
        centered_(problem, frame_),
        options_(options),
        wanted_(wanted),
        system_(centered_.view(), options, /*sums_gauge=*/wanted.inner),
        is_small_(wanted.long_sums && system_.is_small()) {}

  CovarianceOutput Run() {
    if (wanted_.sandwich) RefuseKeptPoints();
    if (is_small_) system_.EliminateByRows();
    HoldGauge();
    CountResiduals();
    if (wanted_.sandwich) CorrectScores();
    Factorize();
    FindDirections();
    FindSteps();
    FindFunctions();
    if (!wanted_.of_images) return std::move(output_);
    FindRelative();
    if (wanted_.sandwich) FindScatter();
    InvertAndCheck();
    if (constraints_ != nullptr && !wanted_.sandwich) {
      constraints_->TransformBlocks(system_.structure(), &system_.values());
    }
    if (wanted_.of_points) FindPoints();
    if (scatter_gauge_ != nullptr) {
      scatter_gauge_->TransformScatter(system_.structure(), &scatter_);
    }
    FindImages();
    FindRigs();
    if (wanted_.of_points) FindKeptPoints();
    for (const NullPoint& null : system_.null_points()) output_.null_points.push_back(null.point);
    output_.warnings = system_.warnings();
    WarnOfTriangle();
    return std::move(output_);
  }

  void FindReliability(const ReliabilityOptions& wanted, ReliabilityOutput* found);
  void FindInfluence(const InfluenceOptions& gradient, Deletions wanted, InfluenceOutput* found);

 private:
  const ParameterLayout& layout() const { return system_.layout(); }
  const AdjustmentProblem& view() const { return centered_.view(); }

  void WarnOfTriangle();
  void CountResiduals();

  /// Throws if a factorisation failed. The unknowns of S are in the order of its elimination, so
  /// that the failed minor identifies the unknown.
  void Check(const LinearSolution& solution) const {
    if (solution.status == LinearStatus::kSuccess) return;
    if (solution.failed_minor > 0) NotDetermined(solution.failed_minor - 1, "a pivot of 0 or less");
    std::string why = solution.message;
    if (!why.empty() && why.back() == '.') why.pop_back();
    throw InputError("problem: expected normal equations of full rank except for the gauge: " +
                     why);
  }

  /// If the gauge of a dense S is fixed (FreeGauge::Hold), an undetermined direction
  /// spreads over all unknowns. Then the unknown with the failed pivot is not meaningful and is not
  /// named.
  [[noreturn]] void NotDetermined(int unknown, const std::string& found) const {
    std::string at;
    if (!system_.structure().dense || output_.gauge_degrees == 0) {
      at = " at " + Words(view(), NameUnknowns(view(), layout())[unknown]);
    }
    throw InputError(
        "problem: expected normal equations of full rank except for the gauge, found " + found +
        at + ": something is not determined by what is observed; bundle diagnose says what");
  }

  void InvertAndCheck() {
    Check(system_.Invert());
    int unknown = -1;
    if (const double inflation = system_.LargestInflation(&unknown); inflation > 1 / kSingular) {
      NotDetermined(unknown, "a variance " + ShortNumber(inflation) +
                                 " times as large as with all other unknowns known");
    }
  }

  /// The factorisation of S detects degrees of freedom that the gauges of a solve leave free.
  void HoldGauge() {
    if (!wanted_.inner && options_.gauge != Gauge::kNone) return;
    gauge_ = std::make_unique<FreeGauge>(system_);
    if (wanted_.inner) {
      gauge_->Hold(&system_);
      output_.gauge_degrees = gauge_->degrees();
    } else if (gauge_->degrees() > 0) {
      throw InputError("gauge: expected one that holds the world, found " +
                       std::to_string(gauge_->degrees()) +
                       " degrees of freedom that nothing determines; use inner");
    }
  }

  /// Y, the covariance times the gauge directions.
  void FindDirections() {
    if (output_.gauge_degrees == 0) return;
    Eigen::MatrixXd y(gauge_->reduced().rows(), gauge_->degrees());
    Check(system_.Solve(gauge_->reduced().data(), gauge_->degrees(), y.data()));
    constraints_ = std::make_unique<InnerConstraints>(*gauge_, std::move(y));
  }

  /// Covariance of blocks (a, b) of the layout under the constraints; zero if the block is not
  /// computed. Unknowns on a bound have no covariance.
  Matrix BlockOf(int a, int b) const {
    Matrix block = Matrix::Zero(layout().blocks()[a].size, layout().blocks()[b].size);
    if (!system_.HasBlock(a, b)) return block;
    system_.CopyBlock(wanted_.sandwich ? scatter_ : system_.values(), a, b, block.data());
    return block;
  }

  /// M of one of an image's maps, with all local columns as rows: local columns x unknowns.
  static Matrix WholeMap(const LocalMap& map) {
    Matrix whole = Matrix::Zero(kLocal, map.size);
    for (size_t i = 0; i < map.columns.size(); ++i) {
      for (int k = 0; k < map.size; ++k) {
        whole(map.columns[i], k) = map.values.empty() ? (static_cast<int>(i) == k ? 1.0 : 0.0)
                                                      : map.values[i * map.size + k];
      }
    }
    return whole;
  }

  /// Joint covariance of (w, t) and parameters of an image.
  Matrix OfImage(int image) const {
    Matrix joint = Matrix::Zero(kLocal, kLocal);
    const std::vector<LocalMap>& maps = system_.evaluator().maps(image);
    for (const LocalMap& a : maps) {
      for (const LocalMap& b : maps) {
        const Matrix block = BlockOf(a.block, b.block);
        if (!a.values.empty() || !b.values.empty()) {
          joint += WholeMap(a).lazyProduct(block).eval().lazyProduct(WholeMap(b).transpose());
          continue;
        }
        for (int i = 0; i < a.size; ++i) {
          for (int j = 0; j < b.size; ++j) joint(a.columns[i], b.columns[j]) += block(i, j);
        }
      }
    }
    return joint;
  }

  /// Transforms a movement of a pose about the centre of the scene to that about the problem's
  /// origin: t = t' - R c.
  Matrix6 MapBack(int pose) const {
    const PoseState& state = system_.states().pose(pose);
    Vector3 arm;
    MatrixVector3(state.rotation, frame_.origin, arm.data());
    Matrix6 map = Matrix6::Identity();
    map.block<3, 3>(3, 0) = Skew(arm);
    return map;
  }

  Matrix6 MovedBack(int pose, const Matrix6& covariance) const {
    if (!centered_.is_moved()) return covariance;
    const Matrix6 map = MapBack(pose);
    return map * covariance * map.transpose();
  }

  static void Put(const Matrix6& covariance, size_t index, std::vector<double>* to) {
    Eigen::Map<Matrix6>(to->data() + 36 * index) = 0.5 * (covariance + covariance.transpose());
  }

  /// Computes poses of images, and cameras from the first observed image of each.
  void FindImages() {
    constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
    const int num_cameras = view().num_cameras, stride = view().camera_params_stride;
    output_.poses.resize(36 * size_t(view().num_images));
    output_.cameras.assign(size_t(num_cameras) * stride * stride, kUnknown);
    const bool rolls = !view().row_scale.empty();
    output_.twists.resize(rolls ? 36 * size_t(view().num_images) : 0);
    if (rolls) FindReadouts();
    std::vector<uint8_t> is_done(num_cameras);
    const std::vector<uint8_t> is_observed = FindObservedImages(view());
    for (int i = 0; i < view().num_images; ++i) {
      const Matrix joint = OfImage(i);
      Put(MovedBack(i, joint.topLeftCorner<6, 6>()), i, &output_.poses);
      if (rolls) Put(joint.block<6, 6>(kFirstTwist, kFirstTwist), i, &output_.twists);
      if (is_observed[i] == 0) {
        const bool is_free = !system_.evaluator().maps(i).empty();
        if (!is_free) std::fill_n(&output_.poses[36 * size_t(i)], 36, kUnknown);
      } else if (const int camera = view().image_camera[i]; is_done[camera] == 0) {
        is_done[camera] = 1;
        PutCamera(i, joint, &output_.cameras[size_t(camera) * stride * stride]);
      }
    }
  }

  void FindReadouts() {
    output_.readouts.assign(view().num_cameras, std::numeric_limits<double>::quiet_NaN());
    for (int c = 0; c < view().num_cameras; ++c) {
      const int block = layout().readout_block(c);
      if (block >= 0) output_.readouts[c] = BlockOf(block, block)(0, 0);
    }
  }

  /// Covariance of the refined intrinsics, stride x stride.
  void PutCamera(int image, const Matrix& joint, double* to) const {
    const int stride = view().camera_params_stride;
    const uint32_t refined = layout().RefinedColumns(view(), image) >> kPoseSize;
    for (int a = 0; a < std::min(stride, kMaxCameraParams); ++a) {
      for (int b = 0; b < std::min(stride, kMaxCameraParams); ++b) {
        if ((refined >> a & refined >> b & 1) == 0) continue;
        to[size_t(a) * stride + b] =
            0.5 * (joint(kPoseSize + a, kPoseSize + b) + joint(kPoseSize + b, kPoseSize + a));
      }
    }
  }

  void FindRigs() {
    output_.frames.resize(36 * size_t(view().num_frames));
    output_.sensors.resize(36 * size_t(view().num_sensors));
    for (int pose = view().num_images; pose < NumPoses(view()); ++pose) {
      Matrix6 covariance = Matrix6::Zero();
      if (const int index = layout().pose_block(pose); index >= 0) {
        const CameraBlock& block = layout().blocks()[index];
        const Matrix own = BlockOf(index, index);
        for (int a = 0; a < block.size; ++a) {
          for (int b = 0; b < block.size; ++b)
            covariance(block.columns[a], block.columns[b]) = own(a, b);
        }
      }
      const int frame = pose - view().num_images, sensor = frame - view().num_frames;
      if (sensor < 0) {
        Put(MovedBack(pose, covariance), frame, &output_.frames);
      } else {
        Put(covariance, sensor, &output_.sensors);
      }
    }
  }

  static Matrix3 Skew(const Vector3& v) {
    Matrix3 m;
    m << 0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0;
    return m;
  }

  /// Threshold for L_jj^2 / S_jj, and for S_jj^-1 over a variance. If S is singular, a pivot is
  /// below this threshold, or a variance is above it, because of rounding. The ratios of regular
  /// blocks stay below 1e10.
  static constexpr double kSingular = 1e-13;
  static constexpr int kLocal = kImageColumns;

  // reliability.cpp
  void FindLeverages(const LongMatrix& inverse, const ReliabilityOptions& wanted,
                     ReliabilityOutput* found);
  Eigen::MatrixXd CovarianceOf(const std::vector<int>& unknowns, const LongMatrix& inverse) const;
  void FindWorst(const ReliabilityOptions& wanted, ReliabilityOutput* found) const;
  std::vector<int> PointsBeside(const ReliabilityOutput& found) const;
  void FindEffects(BlockValues inverse, ReliabilityOutput* found);
  double LargestShare(const std::vector<uint8_t>& is_wanted, const Eigen::MatrixXd& root) const;
  void MovePoints(const std::vector<int>& effects, const Matrix& x, const Eigen::MatrixXd& own,
                  const std::vector<int>& by_rows, const std::vector<uint8_t>& is_in_lanes,
                  ReliabilityOutput* found);
  void SubtractEliminated(const PointBlocks& blocks, const Vector3& b, Eigen::MatrixXd* columns,
                          int k) const;
  // influence.cpp
  Eigen::MatrixXd GradientOfCameras(const InfluenceOptions& wanted) const;
  // covariance_computation.cpp
  void CorrectScores();
  LongMatrix SumHeld() const;
  LongMatrix LongInverse() const;
  void Factorize();
  void FindScatter();
  // covariance.cpp
  void FindPoints();
  void RefuseKeptPoints() const;
  Matrix3 OfKeptPoint(int point) const;
  void FindKeptPoints();
  void TakeGaugeOut(int point, const double* inverse, Matrix3* covariance) const;
  Matrix3 OfPoint(int point, const PointBlocks& blocks, PaddedRows* y) const;
  Matrix3 ScatterOfPoint(int point, const PointBlocks& blocks, const PointAssembler& rows,
                         PaddedRows* y) const;
  // covariance_computation.cpp
  void FindRelative();
  Matrix6 OfRelativePose(int a, int b, const Matrix& from_a, const Matrix& from_b) const;
  Eigen::MatrixXd UnknownsOfImage(int image) const;
  Matrix CovarianceTimes(const Eigen::MatrixXd& rhs);
  void FindFunctions();
  Eigen::MatrixXd AddFunctionsOfPoints(Eigen::MatrixXd* rhs) const;
  Matrix LocalRows(int image, const Matrix& columns) const;
  void FindSteps();

  const SceneFrame frame_;
  const CenteredProblem centered_;
  const SolveOptions& options_;
  const CovarianceOptions& wanted_;
  ReducedSystem system_;
  const bool is_small_;
  std::unique_ptr<FreeGauge> gauge_;
  std::unique_ptr<InnerConstraints> constraints_;  ///< used if the gauge has degrees of freedom
  std::unique_ptr<ScatterGauge>
      scatter_gauge_;  ///< also for this case, in the sandwich of a large system
  LongMatrix lower_;   ///< L of S, of a small system
  std::unique_ptr<LongScatter> long_scatter_;  ///< scatter of a small system
  BlockValues scatter_;                        ///< D, and finally D'; for the sandwich
  double variance_ = 1;                        ///< s^2 of the sandwich
  Matrix step_;                                ///< Newton step of the unknowns, one column
  CovarianceOutput output_;
};

}  // namespace bundle
