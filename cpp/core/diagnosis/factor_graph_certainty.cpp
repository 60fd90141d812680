#include "core/diagnosis/factor_graph_certainty.h"

/// Covariances. At a minimum the covariance of the free coordinates is G = H^-1. Blocks of
/// variables with a common factor are in the selected inverse (linear/selected_inverse.cpp); other
/// pairs take a right-hand side per coordinate.
///
/// Inner constraints. N spans the null space of H. With as many coordinates held as N has columns,
/// such that no direction of N is zero there, H_ff of the others is regular, and N follows from its
/// held rows: H N = 0 means N_f = -H_ff^-1 H_fh N_h. With N orthonormal, G zero at held
/// coordinates, and Y = G N,
///
///   H^+ = (I - N N^T) G (I - N N^T) = G - N Y^T - Y N^T + N (N^T Y) N^T
///
/// is the pseudo-inverse, the covariance of least trace. Errors of N are multiplied by the
/// variances along them: a focal length in pixels that N moves by 1e-12 adds more than the variance
/// of a scene in small units. A second solve for the residual J^T (J N) therefore leaves errors of
/// cond(J), not of cond(H) = cond(J)^2, and entries of N that are rounding errors in the units of S
/// are 0.
///
/// Redundancy. With A the whitened Jacobian of a factor, its whitened error after a fit has the
/// covariance K = I - A G A^T; the trace of K is the redundancy, and r^T K^+ r is distributed as
/// chi2 with rank(K) degrees of freedom. Rows without entries measure nothing and are left out.
/// pose_graph/graph_covariance.cpp has sources and the same computation for edges.
///
/// Spectrum. As in graph_spectrum.cpp: the largest eigenvalues by products with S, the smallest by
/// products with (S + shift)^-1. The null space has a known dimension (jacobian_conditioning.h).
/// Its directions are those of the largest eigenvalues of the inverse; the eigenvalues that follow
/// belong to the determined part.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>

#include "core/dense/decompositions.h"
#include "core/dense/krylov.h"
#include "core/diagnosis/graph_normal_equations.h"
#include "core/error.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

/// As in pose_graph/graph_covariance.cpp.
constexpr double kUncheckedError = 1e-6, kCancelledDigits = 1e-13, kLostDigits = 1e-2;
/// Share of the largest entry of a null direction of S below which an entry is a rounding error.
constexpr double kRoundingOfNull = 1e-11;
constexpr int kColumnsAtATime = 64, kSolvesOfNullSpace = 2;
constexpr int kModes = 4;
/// Tolerances of eigenvectors, and of condition numbers.
constexpr double kSettled = 1e-8, kEnoughDigits = 1e-4;
/// Eigenvalues of the inverse below this share of the largest are left to the next round.
constexpr double kSimilar = 1e-5, kShiftBeside = 1e-11;
constexpr int64_t kNumbersOfBasis = 20'000'000;

using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

PlainMatrix Plain(const MatrixXd& matrix) {
  PlainMatrix plain{matrix.rows(), matrix.cols(), {}};
  plain.values.resize(static_cast<size_t>(matrix.size()));
  Eigen::Map<RowMajorMatrix>(plain.values.data(), matrix.rows(), matrix.cols()) = matrix;
  return plain;
}

class Certainty {
 public:
  Certainty(const FactorGraph& graph, const LinearizedGraph& linear,
            const FactorGraphRequest& request)
      : graph_(graph),
        linear_(linear),
        request_(request),
        seed_(Eigen::Map<const RowMajorMatrix>(request.null_seed.values.data(),
                                               request.null_seed.rows, request.null_seed.columns)),
        system_(graph, linear, request.held, request.num_threads) {}

  FactorGraphCertainty Run() {
    FactorGraphCertainty result;
    result.undetermined = system_.Factorize(0);
    if (result.undetermined >= 0) return result;
    const VectorXd& d = system_.scale();
    const VectorXd scaled = d.cwiseProduct(system_.descent());
    result.predicted_decrease = 0.5 * scaled.dot(system_.Solve(scaled).col(0));
    FindNullDirections();
    std::vector<MatrixXd> across;
    for (const auto& [a, b] : request_.pairs) across.push_back(SolveAcross(a, b));
    system_.Invert();
    for (size_t k = 0; k < across.size(); ++k) {
      const auto [a, b] = request_.pairs[k];
      result.across.push_back(Plain(WithoutGauge(a, b, std::move(across[k]))));
    }
    for (int v = 0; v < static_cast<int>(graph_.blocks.size()); ++v) {
      const MatrixXd block = Padded(v, v, FreeBlock(v, v, &result.inflation));
      const MatrixXd covariance = WithoutGauge(v, v, block);
      result.variables.push_back(Plain(0.5 * (covariance + covariance.transpose())));
    }
    for (int64_t f = 0; request_.of_factors && f < static_cast<int64_t>(graph_.factors.size());
         ++f) {
      TestFactor(f, &result);
    }
    return result;
  }

 private:
  int Begin(int variable) const { return linear_.block_begin[variable]; }
  int Size(int variable) const { return linear_.block_begin[variable + 1] - Begin(variable); }

  /// The free block of H^-1; measures how much its diagonal exceeds that of known neighbours.
  MatrixXd FreeBlock(int i, int j, double* inflation) const {
    if (system_.FirstColumn(i) < 0 || system_.FirstColumn(j) < 0) return {};
    const MatrixXd block = system_.InverseBlock(i, j);
    for (Eigen::Index k = 0; k < block.rows(); ++k) {
      const double scale = system_.scale()[system_.FirstColumn(i) + k];
      const double ratio = block(k, k) / (scale * scale);
      // Below 1 only by rounding; NaN or negative if no digit is left.
      *inflation =
          ratio > 0.5 ? std::max(*inflation, ratio) : std::numeric_limits<double>::infinity();
    }
    return block;
  }

  /// A block by free coordinates as one by all tangent coordinates.
  MatrixXd Padded(int i, int j, const MatrixXd& free) const {
    MatrixXd block = MatrixXd::Zero(Size(i), Size(j));
    if (free.size() == 0) return block;
    const auto rows = FreeOf(i), columns = FreeOf(j);
    block(rows, columns) = free;
    return block;
  }

  std::vector<int> FreeOf(int variable) const {
    std::vector<int> free;
    for (int k = 0; k < Size(variable); ++k) {
      if (request_.held[Begin(variable) + k] == 0) free.push_back(k);
    }
    return free;
  }

  MatrixXd SolveAcross(int i, int j) {
    const int first_i = system_.FirstColumn(i), first_j = system_.FirstColumn(j);
    if (first_i < 0 || first_j < 0) return MatrixXd::Zero(Size(i), Size(j));
    const auto rows = static_cast<int>(FreeOf(i).size());
    const auto columns = static_cast<int>(FreeOf(j).size());
    MatrixXd free(rows, columns);
    for (int begin = 0; begin < columns; begin += kColumnsAtATime) {
      const int count = std::min(kColumnsAtATime, columns - begin);
      MatrixXd unit = MatrixXd::Zero(system_.num_columns(), count);
      for (int c = 0; c < count; ++c) {
        unit(first_j + begin + c, c) = system_.scale()[first_j + begin + c];
      }
      free.middleCols(begin, count) = system_.scale().segment(first_i, rows).asDiagonal() *
                                      system_.Solve(unit).middleRows(first_i, rows);
    }
    return Padded(i, j, free);
  }

  /// N and Y by tangent coordinates.
  void FindNullDirections() {
    if (seed_.cols() == 0) return;
    const VectorXd& d = system_.scale();
    const auto inverse = [&](const MatrixXd& x) {
      return MatrixXd(d.asDiagonal() * system_.Solve(d.asDiagonal() * x));
    };
    n_ = seed_;
    for (int k = 0; k < kSolvesOfNullSpace; ++k) {
      n_(system_.coordinates(), Eigen::all) -=
          inverse(system_.ProductOfAll(n_)(system_.coordinates(), Eigen::all));
    }
    for (Eigen::Index c = 0; c < n_.cols(); ++c) {
      const VectorXd moved = n_(system_.coordinates(), c);
      const VectorXd size = moved.cwiseQuotient(d).cwiseAbs();
      const double rounding = kRoundingOfNull * size.maxCoeff();
      n_(system_.coordinates(), c) = (size.array() < rounding).select(0.0, moved);
    }
    n_ = OrthonormalColumns(n_);
    y_ = MatrixXd::Zero(n_.rows(), n_.cols());
    y_(system_.coordinates(), Eigen::all) = inverse(n_(system_.coordinates(), Eigen::all));
    k_ = MultiplyTransposed(n_, y_);
  }

  MatrixXd WithoutGauge(int i, int j, MatrixXd block) const {
    if (n_.cols() == 0) return block;
    const auto n_i = n_.middleRows(Begin(i), Size(i)), n_j = n_.middleRows(Begin(j), Size(j));
    const auto y_i = y_.middleRows(Begin(i), Size(i)), y_j = y_.middleRows(Begin(j), Size(j));
    return block - Multiply(n_i, y_j.transpose()) - Multiply(y_i, n_j.transpose()) +
           Multiply(Multiply(n_i, k_), n_j.transpose());
  }

  void TestFactor(int64_t factor, FactorGraphCertainty* result) const {
    const GraphNormalEquations::Rows rows = system_.RowsOf(factor);
    const Eigen::Index count = rows.jacobian.rows();
    MatrixXd cofactor = MatrixXd::Zero(count, count);
    double largest = 0;
    Eigen::Index at_i = 0;
    for (const int i : rows.variables) {
      Eigen::Index at_j = 0, width_i = 0;
      for (const int j : rows.variables) {
        const MatrixXd block = system_.InverseBlock(i, j);
        width_i = block.rows();
        const MatrixXd part =
            Multiply(Multiply(rows.jacobian.middleCols(at_i, block.rows()), block),
                     rows.jacobian.middleCols(at_j, block.cols()).transpose());
        if (i == j) largest = std::max(largest, part.trace());
        cofactor += part;
        at_j += block.cols();
      }
      at_i += width_i;
    }
    const double rounding = kCancelledDigits * largest;
    if (!(rounding < kLostDigits)) {
      result->redundancy.push_back(std::numeric_limits<double>::quiet_NaN());
      result->test.push_back(std::numeric_limits<double>::quiet_NaN());
      result->rank.push_back(0);
      return;
    }
    MatrixXd k = -0.5 * (cofactor + cofactor.transpose());
    for (Eigen::Index r = 0; r < count; ++r) {
      if (rows.jacobian.cols() == 0 || rows.jacobian.row(r).any()) k(r, r) += 1;
    }
    const SymmetricEigen pairs = DecomposeSymmetric(k);
    double redundancy = 0, test = 0;
    int rank = 0;
    for (Eigen::Index m = 0; m < count; ++m) {
      if (!(pairs.values[m] > std::max(kUncheckedError, rounding))) continue;
      const double along = pairs.vectors.col(m).dot(rows.residual);
      redundancy += std::min(pairs.values[m], 1.0);
      test += along * along / pairs.values[m];
      ++rank;
    }
    result->redundancy.push_back(redundancy);
    result->test.push_back(test);
    result->rank.push_back(rank);
  }

  const FactorGraph& graph_;
  const LinearizedGraph& linear_;
  const FactorGraphRequest& request_;
  const MatrixXd seed_;
  GraphNormalEquations system_;
  MatrixXd n_, y_, k_;
};

}  // namespace

FactorGraphCertainty ComputeFactorGraphCertainty(const FactorGraph& graph,
                                                 const LinearizedGraph& linear,
                                                 const FactorGraphRequest& request) {
  return Certainty(graph, linear, request).Run();
}

FactorGraphSpectrum FindFactorGraphSpectrum(const FactorGraph& graph, const LinearizedGraph& linear,
                                            std::vector<uint8_t> held, int num_null,
                                            int num_threads) {
  const auto num_tangent = static_cast<Eigen::Index>(held.size());
  GraphNormalEquations system(graph, linear, std::move(held), num_threads);
  const int size = system.num_columns();
  double shift = 0;
  for (const double attempt : {num_null > 0 ? 1e-12 : 0.0, 1e-12, 1e-10, 1e-8}) {
    shift = attempt;
    if (system.Factorize(shift) < 0) break;
    if (attempt == 1e-8) {
      throw InputError(
          "graph: expected normal equations that can be factorised, found numbers that are too "
          "large or too small");
    }
  }
  const VectorXd& d = system.scale();
  const auto largest = [&](int count, int block, double accuracy, const BlockOperator& apply) {
    const auto most =
        static_cast<int>(std::clamp<int64_t>(kNumbersOfBasis / size, 24 + count, 160 + count));
    return FindLargest(size, count, block, most, accuracy, apply);
  };
  const auto scaled = [&](const MatrixXd& x) {
    return MatrixXd(d.asDiagonal() * system.Product(d.asDiagonal() * x));
  };
  // The lowest eigenvalues may differ by many powers of ten: a round finds those of similar size,
  // the next round searches the orthogonal complement of their vectors. A shift then limits the
  // rounding errors that they cause.
  const int wanted = std::min(num_null + kModes, size);
  const double tolerance = num_null > 0 ? kSettled : kEnoughDigits;
  MatrixXd lowest(size, 0);
  std::vector<double> values;
  while (lowest.cols() < wanted) {
    if (lowest.cols() > 0 && shift < kShiftBeside) {
      shift = kShiftBeside;
      system.Factorize(shift);
    }
    const auto beside = [&](MatrixXd x) {
      for (int twice = 0; twice < 2 && lowest.cols() > 0; ++twice) {
        x -= Multiply(lowest, MultiplyTransposed(lowest, x));
      }
      return x;
    };
    const int missing = wanted - static_cast<int>(lowest.cols());
    const EigenPairs found =
        largest(missing, std::max(missing, 2), tolerance,
                [&](const MatrixXd& x) { return beside(system.Solve(beside(x))); });
    const double limit = kSimilar * (found.values.empty() ? 0 : found.values.front());
    const auto count = std::count_if(found.values.begin(), found.values.end(),
                                     [limit](double value) { return value > limit; });
    if (count == 0) break;
    for (int k = 0; k < count; ++k) values.push_back(1 / found.values[k] - shift);
    const Eigen::Index before = lowest.cols();
    lowest.conservativeResize(Eigen::NoChange, before + count);
    lowest.rightCols(count) = found.vectors.leftCols(count);
  }
  FactorGraphSpectrum result;
  const auto unscaled = [&](const MatrixXd& directions) {
    MatrixXd by_coordinate = MatrixXd::Zero(num_tangent, directions.cols());
    by_coordinate(system.coordinates(), Eigen::all) = d.asDiagonal() * directions;
    return by_coordinate;
  };
  const int null = std::min<int>(num_null, static_cast<int>(lowest.cols()));
  const MatrixXd z = lowest.leftCols(null);
  result.null_directions = Plain(unscaled(z));
  result.directions = Plain(unscaled(lowest.rightCols(lowest.cols() - null)));
  result.eigenvalues.assign(values.begin() + null, values.end());
  result.condition_number = result.condition_number_unscaled =
      std::numeric_limits<double>::quiet_NaN();
  if (result.eigenvalues.empty()) return result;
  // NaN for an operator without a finite product
  const auto most_of = [&](const BlockOperator& apply) {
    const std::vector<double> found = largest(1, 2, kEnoughDigits, apply).values;
    return found.empty() ? std::numeric_limits<double>::quiet_NaN() : found.front();
  };
  result.condition_number = most_of(scaled) / result.eigenvalues.front();
  const MatrixXd basis =
      null > 0 ? OrthonormalColumns(d.asDiagonal() * z) : MatrixXd(MatrixXd::Zero(size, 0));
  const auto without = [&](MatrixXd x) {
    for (int twice = 0; twice < 2 && null > 0; ++twice) {
      x -= Multiply(basis, MultiplyTransposed(basis, x));
    }
    return x;
  };
  const double highest = most_of([&](const MatrixXd& x) { return system.Product(x); });
  // H^-1 = D S^-1 D
  const double inverse_of_lowest = most_of([&](const MatrixXd& x) {
    return without(d.asDiagonal() * system.Solve(d.asDiagonal() * without(x)));
  });
  result.condition_number_unscaled = highest * inverse_of_lowest;
  return result;
}

}  // namespace bundle
