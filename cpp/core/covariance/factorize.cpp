/// The factor of a covariance's S, and the sandwich by it: of a small system in long doubles.

#include <Eigen/Core>
#include <memory>
#include <optional>
#include <utility>
#include <vector>

#include "core/covariance/covariance_computation.h"
#include "core/covariance/long_scatter.h"
#include "core/covariance/long_sums.h"
#include "core/covariance/sandwich.h"

namespace bundle {

/// S and what holds its gauge, in long doubles: by rows, or as it was summed up, of a dense
/// system that needs it; empty otherwise.
LongMatrix CovarianceComputation::SumHeld(bool by_rows) const {
  if (by_rows) {
    LongMatrix held = SumSystemOfRows(system_);
    if (output_.gauge_degrees == 0) return held;
    const LongMatrix b = gauge_->HeldDirections().cast<long double>();
    return held + b.lazyProduct(b.transpose());
  }
  if (!wanted_.sandwich || !is_small_) return {};
  return Whole(system_.values(), system_.num_unknowns());
}

void CovarianceComputation::FindScatter() {
  if (is_small_) {
    long_scatter_ =
        std::make_unique<LongScatter>(system_, std::move(lower_), SumMeatOfRows(system_),
                                      constraints_ == nullptr ? nullptr : gauge_.get());
    scatter_ = long_scatter_->OfUnknowns();
    return;
  }
  if (constraints_ != nullptr) scatter_gauge_ = std::make_unique<ScatterGauge>(*gauge_);
  const std::vector<double> meat = SumMeat(system_, scatter_gauge_.get());
  Check(SolveForScatter(&system_, meat, scatter_gauge_.get(), &scatter_));
  if (scatter_gauge_ != nullptr) Check(scatter_gauge_->Finish(&system_, meat));
}

void CovarianceComputation::Factorize(bool by_rows) {
  const LongMatrix held = SumHeld(by_rows);
  Check(system_.Factorize());
  if (held.size() > 0) {
    const Eigen::Index n = held.rows();
    if (std::optional<LongMatrix> lower = LongCholesky(held)) {
      lower_ = std::move(*lower);
      const Eigen::MatrixXd rounded = lower_.cast<double>();
      system_.TakeFactor(rounded.data());
    } else {  // a pivot of rounding, which is judged below
      lower_ = Eigen::Map<const Eigen::MatrixXd>(system_.values().data(), n, n)
                   .triangularView<Eigen::Lower>()
                   .toDenseMatrix()
                   .cast<long double>();
    }
  }
  int unknown = 0;
  const double pivot = system_.SmallestPivot(&unknown);
  if (pivot > kSingular) {
    std::vector<double> step(system_.rhs().size());
    Check(system_.Solve(system_.rhs().data(), 1, step.data()));
    for (size_t j = 0; j < step.size(); ++j) {
      output_.predicted_decrease += 0.5 * step[j] * system_.rhs()[j];
    }
    return;
  }
  NotDetermined(unknown, "a pivot of " + ShortNumber(pivot) + " of its diagonal entry");
}

}  // namespace bundle
