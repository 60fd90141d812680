#include "core/covariance/reliability.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "core/covariance/covariance_computation.h"
#include "core/covariance/leverages.h"
#include "core/dense/decompositions.h"

namespace bundle {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

/// Returns the least eigenvalue of I - h and writes its direction.
double FindWeakest(double h00, double h01, double h11, double* direction) {
  const double half = 0.5 * (h00 - h11), root = std::sqrt(half * half + h01 * h01);
  // Of the two forms of the eigenvector, the one without cancellation.
  double x = half + root, y = h01;
  if (half < 0) {
    x = h01;
    y = root - half;
  }
  const double norm = std::sqrt(x * x + y * y);
  direction[0] = norm > 0 ? x / norm : 1;
  direction[1] = norm > 0 ? y / norm : 0;
  return 1 - 0.5 * (h00 + h11) - root;
}

}  // namespace

void CovarianceComputation::FindReliability(const ReliabilityOptions& wanted,
                                            ReliabilityOutput* found) {
  if (is_small_) system_.EliminateByRows();
  HoldGauge();
  CountResiduals();
  Factorize();
  BlockValues factor = wanted.num_worst > 0 ? system_.values() : BlockValues();
  FindDirections();
  const LongMatrix inverse = LongInverse();
  InvertAndCheck();
  FindLeverages(inverse, wanted, found);  // by C as it is, which has more digits
  if (wanted.num_worst > 0) {
    FindWorst(wanted, found);
    // The poses' covariances need the blocks of the inverse, the movements the factor.
    if (constraints_ != nullptr) {
      constraints_->TransformBlocks(system_.structure(), &system_.values());
    }
    FindImages();
    system_.ExchangeForFactor(&factor);
    FindEffects(std::move(factor), found);
  }
  for (const NullPoint& null : system_.null_points()) output_.null_points.push_back(null.point);
  output_.warnings = system_.warnings();
  found->sums = std::move(output_);
}

void CovarianceComputation::FindLeverages(const LongMatrix& inverse,
                                          const ReliabilityOptions& wanted,
                                          ReliabilityOutput* found) {
  const auto n = static_cast<size_t>(view().num_observations);
  found->residuals.assign(2 * n, kUnknown);
  found->leverages.assign(3 * n, kUnknown);
  found->weights.assign(n, kUnknown);
  found->least.assign(n, kUnknown);
  found->along.assign(2 * n, kUnknown);
  std::map<int, Eigen::MatrixXd> of_points;  // with factors of their own
  system_.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    if (!rows.points.empty()) of_points.emplace(rows.points[0], Matrix3::Zero());
  });
  LeverageOptions options;
  for (const auto& [point, covariance] : of_points) options.points.push_back(point);
  if (wanted.num_worst > 0) {
    output_.points.assign(9 * size_t(view().num_points), kUnknown);
    options.covariances = output_.points.data();
  }
  ForLeverages(
      system_, inverse,
      [&](const Leverage& of) {
        const auto i = static_cast<size_t>(of.observation);
        std::copy_n(of.residual, 2, &found->residuals[2 * i]);
        found->weights[i] = of.weight;
        double* const h = &found->leverages[3 * i];
        h[0] = of.h(0, 0);
        h[1] = 0.5 * (of.h(0, 1) + of.h(1, 0));
        h[2] = of.h(1, 1);
        if (!(of.weight > 0)) return;
        found->least[i] = FindWeakest(h[0], h[1], h[2], &found->along[2 * i]);
      },
      [&](int point, const PointBlocks&, const PointAssembler&, const PointLeverages& leverages) {
        const auto at = of_points.find(point);
        if (at != of_points.end()) at->second = leverages.Covariance();
      },
      options);
  const size_t m = view().factors == nullptr ? 0 : view().factors->factors.size();
  found->factor_measurements.assign(m, 0);
  found->factor_redundancy.assign(m, kUnknown);
  found->factor_least.assign(m, kUnknown);
  found->factor_test.assign(m, kUnknown);
  found->factor_rank.assign(m, 0);
  system_.ForFactors([&](const ReducedSystem::FactorRows& rows) {
    const auto k = static_cast<size_t>(rows.factor);
    const Eigen::MatrixXd j =
        Eigen::Map<const Matrix>(rows.jacobian.data(), rows.num_rows,
                                 static_cast<Eigen::Index>(rows.jacobian.size()) / rows.num_rows);
    Eigen::MatrixXd h = Eigen::MatrixXd::Zero(rows.num_rows, rows.num_rows);
    if (!rows.points.empty()) {
      h = Multiply(Multiply(j, of_points.at(rows.points[0])), j.transpose());
    } else if (!rows.unknowns.empty()) {
      h = Multiply(Multiply(j, CovarianceOf(rows.unknowns, inverse)), j.transpose());
    }
    const SymmetricEigen of = DecomposeSymmetric(0.5 * (h + h.transpose()));
    const Eigen::VectorXd along = MultiplyTransposed(
        of.vectors, Eigen::Map<const Eigen::VectorXd>(rows.residual.data(), rows.num_rows));
    const int idle = rows.num_rows - rows.num_measurements;  // rows that follow from the others
    found->factor_measurements[k] = rows.num_measurements;
    found->factor_redundancy[k] = rows.num_measurements - h.trace();
    found->factor_least[k] = 1 - of.values[rows.num_rows - 1];
    found->factor_test[k] = 0;
    for (Eigen::Index i = idle; i < rows.num_rows; ++i) {
      const double redundancy = 1 - of.values[i];
      if (redundancy < wanted.least) continue;
      found->factor_test[k] += along[i] * along[i] / redundancy;
      ++found->factor_rank[k];
    }
  });
}

/// Entries of C between all pairs of these unknowns, whose blocks a factor couples.
Eigen::MatrixXd CovarianceComputation::CovarianceOf(const std::vector<int>& unknowns,
                                                    const LongMatrix& inverse) const {
  const auto size = static_cast<Eigen::Index>(unknowns.size());
  const BlockStructure& s = system_.structure();
  Eigen::MatrixXd covariance(size, size);
  for (Eigen::Index a = 0; a < size; ++a) {
    for (Eigen::Index b = 0; b < size; ++b) {
      if (inverse.size() > 0) {
        covariance(a, b) = static_cast<double>(inverse(unknowns[a], unknowns[b]));
        continue;
      }
      const int row = std::max(unknowns[a], unknowns[b]);
      const int column = std::min(unknowns[a], unknowns[b]);
      const int i = s.BlockOf(row), j = s.BlockOf(column);
      covariance(a, b) =
          system_.values()[s.ValueIndex(j, s.Entry(j, i), row - s.offset[i], column - s.offset[j])];
    }
  }
  return covariance;
}

ReliabilityOutput ComputeReliability(const AdjustmentProblem& problem, const SolveOptions& options,
                                     const ReliabilityOptions& wanted) {
  SolveOptions all = options;
  all.gauge = Gauge::kNone;
  CovarianceOptions of_inverse;
  of_inverse.long_sums = wanted.long_sums;
  ReliabilityOutput found;
  CovarianceComputation(problem, all, of_inverse).FindReliability(wanted, &found);
  return found;
}

}  // namespace bundle
