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
        options_(options),
        wanted_(wanted),
        system_(centered_.view(), options) {}

  CovarianceOutput Run() {
    if (wanted_.sandwich) {
      system_.UseSecondOrder();
      system_.SetSystem(SumBread(system_));
    }
    HoldGauge();
    CountResiduals();
    Factorize();
    FindDirections();
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
    output_.weighted_squares = system_.point_sums().squares;
    output_.num_residuals = system_.point_sums().num_residuals;
    output_.predicted_decrease = system_.point_sums().decrease;
    system_.ForObservationsOfFixedPoints([&](const ObservationRows& rows) {
      output_.weighted_squares +=
          rows.residual[0] * rows.residual[0] + rows.residual[1] * rows.residual[1];
      output_.num_residuals += 2;
    });
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
    if (pivot > kSingular) {
      std::vector<double> step(system_.rhs().size());
      Check(system_.Solve(system_.rhs().data(), 1, step.data()));
      for (size_t j = 0; j < step.size(); ++j) {
        output_.predicted_decrease += 0.5 * step[j] * system_.rhs()[j];
      }
      return;
    }
    throw InputError(
        "problem: expected normal equations of full rank but for the gauge, found a pivot of " +
        ShortNumber(pivot) +
        " of its diagonal entry: something is not determined by what is observed; bundle diagnose "
        "says what");
  }

  /// What the gauges of a solve leave free is seen when S is factorised.
  void HoldGauge() {
    if (!wanted_.inner && options_.gauge != Gauge::kNone) return;
    const FreeGauge gauge(system_);
    if (wanted_.inner) {
      gauge.Hold(&system_);
      output_.gauge_degrees = gauge.degrees();
      directions_ = gauge.directions();
    } else if (gauge.degrees() > 0) {
      throw InputError("gauge: expected one that holds the world, found " +
                       std::to_string(gauge.degrees()) +
                       " degrees of freedom that nothing determines; use inner");
    }
  }

  /// Y, the covariance times the gauge's directions.
  void FindDirections() {
    if (output_.gauge_degrees == 0) return;
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
    const std::vector<uint8_t> is_observed = FindObservedImages(view());
    for (int i = 0; i < view().num_images; ++i) {
      const Matrix6 covariance = OfImage(i).topLeftCorner<6, 6>();
      Put(MovedBack(i, covariance), i, &output_.poses);
      if (is_observed[i] == 0 && system_.evaluator().maps(i).empty()) {
        std::fill_n(&output_.poses[36 * size_t(i)], 36, std::numeric_limits<double>::quiet_NaN());
      }
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
  const SolveOptions& options_;
  const CovarianceOptions& wanted_;
  ReducedSystem system_;
  FullVectors directions_, y_, y_scatter_;
  std::unique_ptr<InnerConstraints> constraints_, scatter_constraints_;
  std::vector<double> scatter_;  ///< D, where the sandwich is wanted
  CovarianceOutput output_;
};

/// Four numbers that a processor adds at once, at any address.
using Four = double __attribute__((vector_size(32), aligned(8)));

/// W or Y of a point, four numbers a row, the last zero.
struct PaddedRows {
  std::vector<double> values;

  void Set(const std::vector<double>& rows) {
    values.resize(rows.size() / 3 * 4);
    for (size_t i = 0; i < rows.size() / 3; ++i) {
      for (int k = 0; k < 3; ++k) values[4 * i + k] = rows[3 * i + k];
      values[4 * i + 3] = 0;
    }
  }
  const Four* row(int i) const { return reinterpret_cast<const Four*>(&values[4 * size_t(i)]); }
};

/// A third of the time of all covariances goes into the function below: it is compiled for two
/// generations of processors, of which the loader takes one. Sanitizers run before loaders do.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define BUNDLE_FOR_TWO_PROCESSORS __attribute__((target_clones("avx2", "default")))
#else
#define BUNDLE_FOR_TWO_PROCESSORS
#endif

/// X^T A Z over the pairs of a point's blocks, 3 x 3, for the symmetric A. `is_same`: X is Z.
BUNDLE_FOR_TWO_PROCESSORS
void AddPairs(const ReducedSystem& system, const std::vector<double>& values,
              const PointBlocks& blocks, const PaddedRows& x, const PaddedRows& z, bool is_same,
              double sum[9]) {
  const BlockStructure& s = system.structure();
  Four total[3] = {};
  for (size_t b = 0; b < blocks.blocks.size(); ++b) {
    const int j = blocks.blocks[b], columns = s.block_size(j);
    for (size_t a = b; a < blocks.blocks.size(); ++a) {
      const int i = blocks.blocks[a], rows = s.block_size(i);
      const Four* const xi = x.row(blocks.begin[a]);
      const Four* const zi = z.row(blocks.begin[a]);
      const double* block = values.data() + s.ValueIndex(j, s.Entry(j, i), 0, 0);
      for (int c = 0; c < columns; ++c, block += s.panel_stride[j]) {
        // Of a diagonal block, the column from the diagonal down, and the same as a row.
        Four by_x = {}, by_z = {};
        int r = 0;
        if (i == j) {
          by_x = 0.5 * block[c] * xi[c];
          by_z = 0.5 * block[c] * zi[c];
          r = c + 1;
        }
        if (is_same) {
          for (; r < rows; ++r) by_x += block[r] * xi[r];
          by_z = by_x;
        } else {
          for (; r < rows; ++r) {
            by_x += block[r] * xi[r];
            by_z += block[r] * zi[r];
          }
        }
        const Four xj = *x.row(blocks.begin[b] + c), zj = *z.row(blocks.begin[b] + c);
        for (int m = 0; m < 3; ++m) total[m] += by_x[m] * zj + xj[m] * by_z;
      }
    }
  }
  for (int k = 0; k < 9; ++k) sum[k] += total[k / 3][k % 3];
}

void Computation::FindPoints() {
  constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
  output_.points.assign(9 * size_t(view().num_points), 0.0);
  const std::vector<int64_t>& begin = system_.tracks().begin;
  for (int p = 0; p < view().num_points; ++p) {
    if (begin[p] == begin[p + 1]) std::fill_n(&output_.points[9 * size_t(p)], 9, kUnknown);
  }
  const std::vector<double>& c = system_values();
  const std::vector<double>& prior = system_.tracks().prior;
  std::vector<PaddedRows> padded(system_.num_threads());
  system_.ForPoints([&](int p, const PointBlocks& blocks, const PointAssembler& rows, int thread) {
    Eigen::Map<Matrix3> out(&output_.points[9 * size_t(p)]);
    if (blocks.num_null > 0) {
      out.fill(kUnknown);
      return;
    }
    const Eigen::Map<const Matrix3> inverse(blocks.inverse);
    PaddedRows& y = padded[thread];
    y.Set(blocks.y);
    if (!wanted_.sandwich) {
      out = inverse;
      AddPairs(system_, c, blocks, y, y, /*is_same=*/true, out.data());
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
      PaddedRows padded_e;
      padded_e.Set(e);
      AddPairs(system_, c, blocks, y, padded_e, /*is_same=*/false, cross.data());  // V^-1 W^T C E
      AddPairs(system_, scatter_, blocks, y, y, /*is_same=*/true, sum.data());
      const Matrix3 back = cross * inverse;
      out = inverse * Eigen::Map<const Matrix3>(scores.p) * inverse + sum - back - back.transpose();
    }
    if (const InnerConstraints* const inner = constraints(); inner != nullptr) {
      std::vector<double> np(3 * size_t(inner->degrees())), yp(np);
      inner->RowsOfPoint(p, np.data(), yp.data());
      inner->Transform(3, np.data(), yp.data(), 3, np.data(), yp.data(), out.data());
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
