#include "core/covariance/covariance.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <string>

#include "core/covariance/free_gauge.h"
#include "core/covariance/reduced_system.h"
#include "core/covariance/sandwich.h"
#include "core/error.h"
#include "core/geometry/rotation.h"
#include "core/model/scene_frame.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Matrix6 = Eigen::Matrix<double, 6, 6, Eigen::RowMajor>;
using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
using Vector3 = Eigen::Vector3d;

/// Of L_jj^2 beside S_jj: what rounding leaves of a pivot that should be zero is below.
constexpr double kSingular = 1e-13;

constexpr int kLocal = kPoseSize + kMaxCameraParams;

Matrix3 Skew3(const Vector3& v) {
  Matrix3 m;
  m << 0, -v[2], v[1], v[2], 0, -v[0], -v[1], v[0], 0;
  return m;
}

class Computation {
 public:
  Computation(const ProblemView& problem, const SolveOptions& options,
              const CovarianceOptions& wanted)
      : problem_(problem),
        frame_(problem),
        centered_(problem, frame_),
        wanted_(wanted),
        system_(centered_.view(), options) {}

  CovarianceOutput Run() {
    const FreeGauge gauge(system_);
    if (wanted_.inner) {
      gauge.Hold(&system_);
      output_.gauge_degrees = gauge.degrees();
    } else if (gauge.degrees() > 0) {
      throw InputError("gauge: expected one that holds the world, found " +
                       std::to_string(gauge.degrees()) +
                       " degrees of freedom that nothing determines; use inner");
    }
    CountResiduals();
    Factorize();
    FindDirections(gauge);
    FindRelative();
    if (wanted_.sandwich) {
      const std::vector<double> meat = SumMeat(system_);
      Check(SolveForScatter(&system_, meat, &scatter_));
    }
    Check(system_.Invert());
    FindPoses();
    FindCameras();
    if (wanted_.of_points) FindPoints();
    for (const NullPoint& null : system_.null_points()) output_.null_points.push_back(null.point);
    output_.warnings = system_.warnings();
    return std::move(output_);
  }

 private:
  const ParameterLayout& layout() const { return system_.layout(); }
  const ProblemView& view() const { return centered_.view(); }

  void CountResiduals() {
    std::vector<std::pair<double, int64_t>> sums(system_.num_threads());
    const auto add = [](const ObservationRows& rows, std::pair<double, int64_t>* sum) {
      sum->first += rows.residual[0] * rows.residual[0] + rows.residual[1] * rows.residual[1];
      sum->second += 2;
    };
    system_.ForPoints([&](int, const PointBlocks&, const PointAssembler& rows, int thread) {
      for (int i = 0; i < rows.num_rows(); ++i) add(rows.row(i), &sums[thread]);
    });
    std::pair<double, int64_t> rest;
    system_.ForObservationsOfFixedPoints([&](const ObservationRows& rows) { add(rows, &rest); });
    sums.push_back(rest);
    for (const auto& [squares, count] : sums) {
      output_.weighted_squares += squares;
      output_.num_residuals += count;
    }
    system_.ForFactors([&](const ReducedSystem::FactorRows& rows) {
      for (const double r : rows.residual) output_.weighted_squares += r * r;
      output_.num_residuals += rows.num_rows;
    });
    output_.num_parameters = system_.num_unknowns() + 3 * int64_t{layout().num_free_points()};
    for (const uint8_t bit : system_.held()) output_.num_parameters -= bit;
    for (const NullPoint& null : system_.null_points()) output_.num_parameters -= null.num_null;
  }

  static void Check(const LinearSolution& solution) {
    if (solution.status == LinearSolution::Status::kSuccess) return;
    throw InputError("problem: expected normal equations of full rank but for the gauge: " +
                     solution.message);
  }

  void Factorize() {
    Check(system_.Factorize());
    const double pivot = system_.SmallestPivot();
    if (pivot > kSingular) return;
    throw InputError(
        "problem: expected normal equations of full rank but for the gauge, found a pivot of " +
        ShortNumber(pivot) +
        " of its diagonal entry: something is not determined by what is observed; bundle diagnose "
        "says what");
  }

  /// Y, the covariance times the gauge's directions.
  void FindDirections(const FreeGauge& gauge) {
    if (!wanted_.inner || gauge.degrees() == 0) return;
    directions_ = gauge.directions();
    Check(system_.Solve(directions_, &y_));
    constraints_ = std::make_unique<InnerConstraints>(directions_, y_);
    if (!wanted_.sandwich) return;
    Check(system_.Solve(MeatTimes(system_, y_), &y_scatter_));
    scatter_constraints_ = std::make_unique<InnerConstraints>(directions_, y_scatter_);
  }

  /// The constraints of the covariance that is asked for.
  const InnerConstraints* constraints() const {
    return wanted_.sandwich ? scatter_constraints_.get() : constraints_.get();
  }

  /// Turns the covariance of unknowns [first_a, ...) and [first_b, ...) into that under the
  /// constraints.
  void Constrain(int first_a, int first_b, Matrix* block) const {
    const InnerConstraints* const inner = constraints();
    if (inner == nullptr) return;
    const auto rows = static_cast<int>(block->rows()), columns = static_cast<int>(block->cols());
    const int d = inner->degrees();
    std::vector<double> na(size_t(rows) * d), ya(na), nb(size_t(columns) * d), yb(nb);
    inner->RowsOfUnknowns(first_a, rows, na.data(), ya.data());
    inner->RowsOfUnknowns(first_b, columns, nb.data(), yb.data());
    inner->Transform(rows, na.data(), ya.data(), columns, nb.data(), yb.data(), block->data());
  }

  /// Of blocks (a, b) of the layout, under the constraints; zero where it is not known. Unknowns on
  /// a bound have none.
  Matrix BlockOf(int a, int b) const {
    Matrix block = Matrix::Zero(layout().blocks()[a].size, layout().blocks()[b].size);
    if (!system_.HasBlock(a, b)) return block;
    system_.CopyBlock(wanted_.sandwich ? scatter_ : system_values(), a, b, block.data());
    Constrain(layout().blocks()[a].offset, layout().blocks()[b].offset, &block);
    return block;
  }

  const std::vector<double>& system_values() const {
    return const_cast<ReducedSystem&>(system_).values();
  }

  /// M of one of an image's maps, all local columns x unknowns.
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
      const Matrix from = WholeMap(a);
      for (const LocalMap& b : maps) {
        joint += from * BlockOf(a.block, b.block) * WholeMap(b).transpose();
      }
    }
    return joint;
  }

  /// From a pose about the centre that the scene is solved about to the problem's: t = t' - R c.
  Matrix6 MovedBack(int pose, const Matrix6& covariance) const {
    if (!centered_.is_moved()) return covariance;
    const PoseState& state = system_.states().pose(pose);
    Vector3 arm;
    MatrixVector3(state.rotation, frame_.origin, arm.data());
    Matrix6 map = Matrix6::Identity();
    map.block<3, 3>(3, 0) = Skew3(arm);
    return map * covariance * map.transpose();
  }

  static void Put(const Matrix6& covariance, size_t index, std::vector<double>* to) {
    Eigen::Map<Matrix6>(to->data() + 36 * index) = 0.5 * (covariance + covariance.transpose());
  }

  void FindPoses() {
    output_.poses.resize(36 * size_t(view().num_images));
    output_.frames.resize(36 * size_t(view().num_frames));
    output_.sensors.resize(36 * size_t(view().num_sensors));
    for (int i = 0; i < view().num_images; ++i) {
      const Matrix6 covariance = OfImage(i).topLeftCorner<6, 6>();
      Put(MovedBack(i, covariance), i, &output_.poses);
    }
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

  /// By the first image of each.
  void FindCameras() {
    const int stride = view().camera_params_stride;
    const auto size = size_t(stride) * stride;
    output_.cameras.assign(size * view().num_cameras, std::numeric_limits<double>::quiet_NaN());
    std::vector<uint8_t> is_done(view().num_cameras);
    const std::vector<uint8_t> is_observed = FindObservedImages(view());
    for (int i = 0; i < view().num_images; ++i) {
      const int camera = view().image_camera[i];
      if (is_done[camera] != 0 || is_observed[i] == 0) continue;
      is_done[camera] = 1;
      const Matrix joint = OfImage(i);
      const uint32_t refined = layout().RefinedColumns(view(), i) >> kPoseSize;
      for (int a = 0; a < std::min(stride, kMaxCameraParams); ++a) {
        for (int b = 0; b < std::min(stride, kMaxCameraParams); ++b) {
          if ((refined >> a & refined >> b & 1) == 0) continue;
          output_.cameras[size * camera + size_t(a) * stride + b] =
              0.5 * (joint(kPoseSize + a, kPoseSize + b) + joint(kPoseSize + b, kPoseSize + a));
        }
      }
    }
  }

  void FindPoints();
  void FindRelative();
  Matrix6 OfRelativePose(int a, int b, const Matrix& from_a, const Matrix& from_b) const;
  Matrix ColumnsOfImage(int image);
  Matrix LocalRows(int image, const Matrix& columns) const;

  const ProblemView& problem_;
  const SceneFrame frame_;
  const CenteredProblem centered_;
  const CovarianceOptions& wanted_;
  ReducedSystem system_;
  FullVectors directions_, y_, y_scatter_;
  std::unique_ptr<InnerConstraints> constraints_, scatter_constraints_;
  std::vector<double> scatter_;  ///< D, where the sandwich is wanted
  CovarianceOutput output_;
};

/// X^T A Z over the pairs of a point's blocks, 3 x 3; `x` and `z` as PointBlocks::w.
void AddPairs(const ReducedSystem& system, const std::vector<double>& values,
              const PointBlocks& blocks, const std::vector<double>& x, const std::vector<double>& z,
              double sum[9]) {
  const BlockStructure& s = system.structure();
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const int j = blocks.blocks[b], columns = s.block_size(j);
    const double* const xj = &x[3 * size_t(blocks.begin[b])];
    const double* const zj = &z[3 * size_t(blocks.begin[b])];
    for (size_t a = b; a < blocks.blocks.size(); ++a) {
      const int i = blocks.blocks[a], rows = s.block_size(i);
      const double* const xi = &x[3 * size_t(blocks.begin[a])];
      const double* const zi = &z[3 * size_t(blocks.begin[a])];
      const double* block = values.data() + s.ValueIndex(j, s.Entry(j, i), 0, 0);
      for (int c = 0; c < columns; ++c, block += s.panel_stride[j]) {
        // Of a diagonal block, the column from the diagonal down and the same as a row.
        double by_x[3] = {}, by_z[3] = {};
        for (int r = i == j ? c : 0; r < rows; ++r) {
          const double value = i == j && r == c ? 0.5 * block[r] : block[r];
          for (int k = 0; k < 3; ++k) {
            by_x[k] += value * xi[3 * r + k];
            by_z[k] += value * zi[3 * r + k];
          }
        }
        for (int k = 0; k < 9; ++k) {
          sum[k] += by_x[k / 3] * zj[3 * c + k % 3] + xj[3 * c + k / 3] * by_z[k % 3];
        }
      }
    }
  }
}

void Computation::FindPoints() {
  output_.points.assign(9 * size_t(view().num_points), 0.0);
  const std::vector<double>& c = system_values();
  const std::vector<double>& prior = system_.tracks().prior;
  system_.ForPoints([&](int p, const PointBlocks& blocks, const PointAssembler& rows, int) {
    Eigen::Map<Matrix3> out(&output_.points[9 * size_t(p)]);
    if (blocks.num_null > 0) {
      out.fill(std::numeric_limits<double>::quiet_NaN());
      return;
    }
    const Eigen::Map<const Matrix3> inverse(blocks.inverse);
    if (!wanted_.sandwich) {
      out = inverse;
      AddPairs(system_, c, blocks, blocks.y, blocks.y, out.data());
    } else {
      PointScores scores;
      SumScores(blocks, rows, prior.empty() ? nullptr : &prior[9 * size_t(p)], &scores);
      std::vector<double>& e = scores.f;
      for (size_t i = 0; i < e.size(); i += 3) {
        double by_p[3];
        VectorMatrix3(&blocks.y[i], scores.p, by_p);
        for (int k = 0; k < 3; ++k) e[i + k] -= by_p[k];
      }
      Matrix3 cross = Matrix3::Zero(), sum = Matrix3::Zero();
      AddPairs(system_, c, blocks, blocks.y, e, cross.data());  // V^-1 W^T C E
      AddPairs(system_, scatter_, blocks, blocks.y, blocks.y, sum.data());
      const Matrix3 back = cross * inverse;
      out = inverse * Eigen::Map<const Matrix3>(scores.p) * inverse + sum - back - back.transpose();
    }
    if (const InnerConstraints* const inner = constraints(); inner != nullptr) {
      std::vector<double> n(3 * size_t(inner->degrees())), y(n);
      inner->RowsOfPoint(p, n.data(), y.data());
      inner->Transform(3, n.data(), y.data(), 3, n.data(), y.data(), out.data());
    }
    out = (0.5 * (out + out.transpose())).eval();
  });
}

/// The covariance of all unknowns with the pose of an image: unknowns x 6.
Matrix Computation::ColumnsOfImage(int image) {
  const int n = system_.num_unknowns();
  Eigen::MatrixXd rhs = Eigen::MatrixXd::Zero(n, 6), x(n, 6);
  for (const LocalMap& map : system_.evaluator().maps(image)) {
    rhs.middleRows(layout().blocks()[map.block].offset, map.size) +=
        WholeMap(map).topRows<6>().transpose();
  }
  x.setZero();
  Check(system_.Solve(rhs.data(), 6, x.data()));
  if (wanted_.sandwich) {
    FullVectors with_points;  // M H^-1, whose points follow from the cameras
    with_points.num_columns = 6;
    with_points.cameras.assign(rhs.data(), rhs.data() + rhs.size());
    with_points.points.assign(18 * size_t(view().num_points), 0.0);
    FullVectors once, twice;
    Check(system_.Solve(with_points, &once));
    Check(system_.Solve(MeatTimes(system_, once), &twice));
    x = Eigen::Map<const Eigen::MatrixXd>(twice.cameras.data(), n, 6);
  }
  Matrix columns = x;
  if (const InnerConstraints* const inner = constraints(); inner != nullptr && n > 0) {
    // The transformation of the columns' own unknowns, by the image's maps.
    const int d = inner->degrees();
    std::vector<double> na(size_t(n) * d), ya(na);
    inner->RowsOfUnknowns(0, n, na.data(), ya.data());
    const Eigen::Map<const Matrix> all_n(na.data(), n, d), all_y(ya.data(), n, d);
    const Matrix own_n = rhs.transpose() * all_n, own_y = rhs.transpose() * all_y;
    inner->Transform(n, na.data(), ya.data(), 6, own_n.data(), own_y.data(), columns.data());
  }
  return columns;
}

/// The rows of an image's pose: 6 x 6.
Matrix Computation::LocalRows(int image, const Matrix& columns) const {
  Matrix rows = Matrix::Zero(6, 6);
  for (const LocalMap& map : system_.evaluator().maps(image)) {
    rows += WholeMap(map).topRows<6>() *
            columns.middleRows(layout().blocks()[map.block].offset, map.size);
  }
  return rows;
}

Matrix6 Computation::OfRelativePose(int a, int b, const Matrix& from_a,
                                    const Matrix& from_b) const {
  const PoseState &pose_a = system_.states().pose(a), &pose_b = system_.states().pose(b);
  const Matrix3 relative = Eigen::Map<const Matrix3>(pose_b.rotation) *
                           Eigen::Map<const Matrix3>(pose_a.rotation).transpose();
  const Matrix3 arm = Skew3(relative * Eigen::Map<const Vector3>(pose_a.translation));
  Matrix6 by_a = Matrix6::Zero(), by_b = Matrix6::Identity();
  by_a.block<3, 3>(0, 0) = -relative;
  by_a.block<3, 3>(3, 0) = -arm * relative;
  by_a.block<3, 3>(3, 3) = -relative;
  by_b.block<3, 3>(3, 0) = arm;
  const Matrix6 aa = LocalRows(a, from_a), ba = LocalRows(b, from_a), bb = LocalRows(b, from_b);
  const Matrix6 mixed = by_b * ba * by_a.transpose();
  return by_a * aa * by_a.transpose() + by_b * bb * by_b.transpose() + mixed + mixed.transpose();
}

void Computation::FindRelative() {
  output_.relative.resize(36 * wanted_.relative.size());
  for (size_t k = 0; k < wanted_.relative.size(); ++k) {
    ThrowIfInterrupted();
    const auto [a, b] = wanted_.relative[k];
    Put(OfRelativePose(a, b, ColumnsOfImage(a), ColumnsOfImage(b)), k, &output_.relative);
  }
}

}  // namespace

CovarianceOutput ComputeCovariance(const ProblemView& problem, const SolveOptions& options,
                                   const CovarianceOptions& wanted) {
  SolveOptions all = options;
  if (wanted.inner) all.gauge = Gauge::kNone;
  return Computation(problem, all, wanted).Run();
}

}  // namespace bundle
