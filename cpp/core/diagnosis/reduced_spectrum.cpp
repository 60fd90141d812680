#include "core/diagnosis/reduced_spectrum.h"

/// S has one zero eigenvalue for each direction of the refined parameters that changes no residual:
/// its null space. S is scaled first: its diagonal spans many orders of magnitude (radians, metres,
/// pixels, coefficients), and unscaled eigenvalues cannot be compared. In the scaled S, zeros are
/// rounding errors of 1e-13 or less, and all other eigenvalues are clearly larger.
///
/// 1. Points without parallax are removed exactly (covariance/point_blocks.h), and so are unknowns
///    that no residual determines (scaled_system.cpp).
/// 2. Derivatives w.r.t. similarities of the world are known (model/gauge.h), and so are those of
///    each piece that no point connects with other pieces. S is positive semidefinite, so that
///    combinations z of them with z^T S z = 0 up to rounding (scaled_system.cpp) are null
///    directions.
/// 3. Further directions with the lowest eigenvalues of S have the highest eigenvalues of (S +
///    shift)^-1, projected orthogonal to the known directions (krylov.h). Those with z^T S z = 0
///    are null directions, too, and are added to the known ones.
/// 4. The gauge is a part of the null space. Let N be an orthonormal basis of the null space and G
///    one of the similarities of the world. The singular values of (I - N N^T) G are the sines of
///    the principal angles (Bjorck and Golub 1973). Each zero among them is a similarity that
///    changes no residual.
///
/// The condition number of the unscaled S needs its smallest nonzero eigenvalue. This is the
/// inverse of the largest eigenvalue of the pseudo-inverse, P diag(d) (scaled S)^-1 diag(d) P. P
/// projects orthogonal to the null space of the unscaled S, which is the null space of the scaled S
/// times d.

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/dense/decompositions.h"
#include "core/dense/krylov.h"
#include "core/diagnosis/deflation.h"
#include "core/diagnosis/scaled_system.h"
#include "core/model/gauge.h"
#include "core/model/gauge_count.h"
#include "core/model/scene_frame.h"
#include "core/model/unknown_names.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kZeroEigenvalue = 1e-11;
constexpr double kShift = 1e-10;
/// A similarity is not a null direction if the sine of its principal angle is at least this value.
constexpr double kZeroSine = 1e-4;
/// If the spread of the cameras, relative to the distance of the points, is below this value, they
/// count as being at one place.
constexpr double kOnePlace = 1e-9;
/// Maximum number of null directions beyond the gauge that are searched for.
constexpr int kMostNull = 64;
constexpr int kBlock = 8;
constexpr int kMostDimensions = 200;

std::vector<double> RowMajor(const MatrixXd& matrix) {
  std::vector<double> values;
  values.reserve(matrix.size());
  for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
    for (Eigen::Index j = 0; j < matrix.cols(); ++j) values.push_back(matrix(i, j));
  }
  return values;
}

/// The piece of each unknown. Sensors and shared cameras belong to the world if it is one piece.
std::vector<int> FindPieces(const AdjustmentProblem& problem, const std::vector<UnknownName>& names,
                            const int32_t* image_piece) {
  std::vector<int> frame_piece(problem.num_frames, -1);
  int num_pieces = 0;
  for (int i = 0; i < problem.num_images; ++i) {
    num_pieces = std::max(num_pieces, image_piece[i] + 1);
    const int frame = problem.FrameOf(i);
    if (frame >= 0 && image_piece[i] >= 0) frame_piece[frame] = image_piece[i];
  }
  std::vector<int> point_piece(problem.num_points, -1);
  for (int64_t i = 0; i < problem.num_observations; ++i) {
    point_piece[problem.observation_point[i]] = image_piece[problem.observation_image[i]];
  }
  std::vector<int> pieces;
  for (const UnknownName& name : names) {
    int piece = name.kind == UnknownName::kPoint ? point_piece[name.index] : -1;
    const bool is_of_image = name.kind == UnknownName::kImage || name.kind == UnknownName::kTwist;
    if (is_of_image) piece = image_piece[name.index];
    if (name.kind == UnknownName::kFrame) piece = frame_piece[name.index];
    if (name.kind == UnknownName::kSensor && num_pieces == 1) piece = 0;
    pieces.push_back(piece);
  }
  return pieces;
}

class SpectrumSearch {
 public:
  SpectrumSearch(const AdjustmentProblem& problem, const SolveOptions& options)
      : problem_(problem),
        reduced_(problem, options),
        names_(NameUnknowns(problem, reduced_.layout())),
        system_(&reduced_, SquaredColumns(reduced_), Units()) {}

  ReducedSpectrum Run(const int32_t* image_piece, int num_modes) {
    result_.unknowns = names_;
    result_.scale = system_.scale();
    for (int j = 0; j < system_.size(); ++j) result_.unseen.push_back(!system_.is_seen(j));
    result_.null_points = reduced_.null_points();
    result_.warnings = reduced_.warnings();
    result_.expected_nullity = CountGaugeDegrees(problem_, reduced_.layout().free());
    result_.condition_number_unscaled = std::numeric_limits<double>::quiet_NaN();
    const int num_unseen =
        static_cast<int>(std::count(result_.unseen.begin(), result_.unseen.end(), uint8_t{1}));
    if (system_.size() == 0) return std::move(result_);

    const MatrixXd similarities = WorldSimilarities();
    Deflation known(FindPieces(problem_, result_.unknowns, image_piece), similarities);
    known.KeepNull(AboveRounding(known.directions()), kZeroEigenvalue);
    const MatrixXd& null = known.directions();
    result_.max_null_eigenvalue =
        null.cwiseProduct(system_.Multiply(null)).colwise().sum().cwiseAbs().maxCoeff();
    if (num_unseen < system_.size() && Factorize()) {
      FindLowest(num_unseen, num_modes, &known);
      FindHighest();
      if (known.count() <= kMostNull) FindUnscaledCondition(known);
    }
    CountGauge(similarities, known);
    result_.nullity = num_unseen + known.count() + num_hidden_;
    if (result_.nullity > result_.num_gauge) result_.failed_unknown = system_.Factorize(0);
    return std::move(result_);
  }

 private:
  /// Meaningful changes: a radian, the distance of the points, the size of a parameter, 1 for a
  /// coefficient.
  std::vector<double> Units() const {
    const double distance = MedianDistance();
    std::vector<double> units;
    for (const UnknownName& name : names_) {
      double unit = name.coordinate < 3 ? 1 : distance;
      if (name.kind == UnknownName::kCamera) {
        unit = std::max(1.0, std::abs(problem_.ParamsOf(name.index)[name.coordinate]));
      }
      if (name.kind == UnknownName::kReadout) unit = 1;
      if (name.kind == UnknownName::kPoint) unit = distance;
      units.push_back(unit);
    }
    return units;
  }

  bool Factorize() {
    for (const double shift : {kShift, 1e3 * kShift, 1e6 * kShift}) {
      result_.failed_unknown = system_.Factorize(shift);
      if (result_.failed_unknown < 0) return true;
    }
    result_.failure = "The reduced camera system cannot be factorised.";
    return false;
  }

  /// Similarities in units of the unknowns. The scale is left out if it moves no camera.
  MatrixXd WorldSimilarities() {
    const std::vector<double> rows =
        GaugeDirections(problem_, reduced_.layout(), reduced_.states());
    using Rows = Eigen::Matrix<double, Eigen::Dynamic, kNumGaugeDirections, Eigen::RowMajor>;
    MatrixXd similarities =
        Eigen::Map<const Rows>(rows.data(), system_.size(), kNumGaugeDirections);
    // A similarity also scales the translations of sensors on rigs.
    for (int j = 0; j < system_.size(); ++j) {
      const UnknownName& name = result_.unknowns[j];
      if (name.kind != UnknownName::kSensor || name.coordinate < 3) continue;
      similarities(j, 6) =
          problem_.sensor_from_rig[7 * int64_t{name.index} + 4 + name.coordinate - 3];
    }
    if (similarities.col(6).lpNorm<Eigen::Infinity>() <= kOnePlace * MedianDistance()) {
      similarities.col(6).setZero();
      const LargeVector<int64_t> lengths = TrackLengths(problem_);
      num_hidden_ = 1;
      for (int p = 0; p < problem_.num_points; ++p) {
        if (lengths[p] > 0 && !reduced_.layout().point_is_free(p)) num_hidden_ = 0;
      }
    }
    for (int j = 0; j < system_.size(); ++j) {
      similarities.row(j) *= system_.is_seen(j) ? 1 / system_.scale()[j] : 0.0;
    }
    return similarities;
  }

  /// Median distance of points from the images that see them.
  double MedianDistance() const {
    std::vector<double> distances;
    const int64_t step = std::max<int64_t>(problem_.num_observations / 1000, 1);
    for (int64_t i = 0; i < problem_.num_observations; i += step) {
      const PoseState& pose = reduced_.states().pose(problem_.observation_image[i]);
      using Matrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
      const double* const point = problem_.points + 3 * int64_t{problem_.observation_point[i]};
      distances.push_back(
          (Eigen::Map<const Matrix3>(pose.rotation) * Eigen::Map<const Eigen::Vector3d>(point) +
           Eigen::Map<const Eigen::Vector3d>(pose.translation))
              .norm());
    }
    if (distances.empty()) return 1;
    const auto middle = distances.begin() + static_cast<int64_t>(distances.size()) / 2;
    std::nth_element(distances.begin(), middle, distances.end());
    return *middle;
  }

  MatrixXd BesideUnseen(MatrixXd x) const {
    for (int j = 0; j < system_.size(); ++j) {
      if (!system_.is_seen(j)) x.row(j).setZero();
    }
    return x;
  }

  MatrixXd AboveRounding(const MatrixXd& x) { return system_.Multiply(x) - system_.Rounding(x); }

  void FindLowest(int num_unseen, int num_modes, Deflation* known) {
    MatrixXd null(system_.size(), 0);
    for (;;) {
      const int left = system_.size() - num_unseen - known->count();
      const EigenPairs found = FindLargest(
          system_.size(), std::min(num_modes, left), kBlock, kMostDimensions, 1e-4,
          [&](const MatrixXd& x) {
            return BesideUnseen(known->Project(system_.Solve(known->Project(BesideUnseen(x)))));
          });
      if (left <= 0) break;
      const MatrixXd product = system_.Multiply(found.vectors);
      std::vector<int> is_null, is_weak;
      for (int k = 0; k < found.vectors.cols(); ++k) {
        const double value = found.vectors.col(k).dot(product.col(k));
        const double rounding =
            found.vectors.col(k).dot(system_.Rounding(found.vectors.col(k)).col(0));
        if (value - rounding <= kZeroEigenvalue) {
          is_null.push_back(k);
          result_.max_null_eigenvalue = std::max(result_.max_null_eigenvalue, value);
        } else {
          is_weak.push_back(k);
          result_.eigenvalues.push_back(value);
        }
      }
      if (is_null.empty() || null.cols() >= kMostNull) {
        result_.nullity_is_exact = is_null.empty();
        SortModes(found.vectors(Eigen::all, is_weak));
        break;
      }
      result_.eigenvalues.clear();
      const MatrixXd more = Orthonormalize(null, found.vectors(Eigen::all, is_null));
      null.conservativeResize(Eigen::NoChange, null.cols() + more.cols());
      null.rightCols(more.cols()) = more;
      known->Add(more);
    }
    result_.null_directions = RowMajor(null);
    result_.num_null_directions = static_cast<int>(null.cols());
  }

  void SortModes(const MatrixXd& directions) {
    std::vector<int> order(result_.eigenvalues.size());
    for (size_t k = 0; k < order.size(); ++k) order[k] = static_cast<int>(k);
    std::sort(order.begin(), order.end(),
              [&](int a, int b) { return result_.eigenvalues[a] < result_.eigenvalues[b]; });
    std::vector<double> values;
    for (const int k : order) values.push_back(result_.eigenvalues[k]);
    result_.eigenvalues = std::move(values);
    result_.directions = RowMajor(directions(Eigen::all, order));
  }

  void FindHighest() {
    const EigenPairs found = FindLargest(system_.size(), 1, 2, 80, 1e-5, [&](const MatrixXd& x) {
      return BesideUnseen(system_.Multiply(BesideUnseen(x)));
    });
    result_.max_eigenvalue = found.values.empty() ? 0 : found.values.front();
  }

  void FindUnscaledCondition(const Deflation& known) {
    const VectorXd d = Eigen::Map<const VectorXd>(system_.scale().data(), system_.size());
    const VectorXd inverse = (d.array() > 0).select(1 / d.array(), 0.0);
    const EigenPairs high = FindLargest(system_.size(), 1, 2, 80, 1e-4, [&](const MatrixXd& x) {
      return MatrixXd(inverse.asDiagonal() * system_.Multiply(inverse.asDiagonal() * x));
    });
    const MatrixXd null =
        Orthonormalize(MatrixXd(system_.size(), 0), d.asDiagonal() * known.Dense());
    const auto project = [&](MatrixXd x) {
      for (int twice = 0; twice < 2; ++twice) {
        x -= Multiply(null, MultiplyTransposed(null, x));
      }
      return x;
    };
    const EigenPairs low = FindLargest(system_.size(), 1, 2, 80, 1e-4, [&](const MatrixXd& x) {
      const MatrixXd scaled = known.Project(d.asDiagonal() * project(x));
      return project(d.asDiagonal() * known.Project(system_.Solve(scaled)));
    });
    if (high.values.empty() || low.values.empty()) return;
    result_.condition_number_unscaled = high.values.front() * low.values.front();
  }

  void CountGauge(const MatrixXd& similarities, const Deflation& known) {
    const MatrixXd basis = Orthonormalize(MatrixXd(system_.size(), 0), similarities);
    const auto vanish = kNumGaugeDirections - static_cast<int>(basis.cols());
    const bool scale_is_seen = similarities.col(6).isZero(0) && num_hidden_ == 0;
    result_.num_gauge = vanish - (scale_is_seen ? 1 : 0);
    if (basis.cols() == 0) return;
    const MatrixXd rest = known.Project(basis);
    const VectorXd sines = SingularValues(rest);
    result_.num_gauge += static_cast<int>((sines.array() < kZeroSine).count());
  }

  const AdjustmentProblem& problem_;
  ReducedSystem reduced_;
  const std::vector<UnknownName> names_;
  ScaledSystem system_;
  int num_hidden_ = 0;  ///< number of similarities that move only points
  ReducedSpectrum result_;
};

}  // namespace

ReducedSpectrum FindReducedSpectrum(const AdjustmentProblem& problem, const SolveOptions& options,
                                    const int32_t* image_piece, int num_modes) {
  const SceneFrame frame(problem);
  const CenteredProblem centered(problem, frame);
  return SpectrumSearch(centered.view(), options).Run(image_piece, num_modes);
}

}  // namespace bundle
