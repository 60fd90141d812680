#pragma once

/// One computation of derivatives w.r.t. the data, step by step (adjoint.h has the mathematics).

#include <cstdint>
#include <vector>

#include "core/covariance/adjoint.h"
#include "core/covariance/covariance_computation.h"
#include "core/model/problem_factors.h"

namespace bundle {

class AdjointComputation final : public AdjointSystem {
 public:
  AdjointComputation(const AdjustmentProblem& problem, const ProblemFactors* all,
                     const SolveOptions& options, bool exact);

  int64_t size() const override { return num_unknowns() + 3 * int64_t{all_.num_points}; }
  int degrees() const override { return computation_.gauge_->degrees(); }
  bool is_exact() const override { return is_exact_; }
  std::vector<uint8_t> Held() const override;
  void Directions(double* n, double* of_sums) const override;
  void Solve(const double* y, double* a) override;
  std::vector<double> Gather(const InfluenceOptions& derivatives) const override;
  void Gradient(const double* step, double* gradient) override;
  AdjointRows Product(const double* a, double e) override;
  SolveOutput Moved(const double* step) override;

 private:
  const ReducedSystem& system() const { return computation_.system_; }
  const ParameterLayout& layout() const { return computation_.layout(); }
  int num_unknowns() const { return system().num_unknowns(); }
  /// The problem at another state.
  struct Place {
    explicit Place(const AdjointComputation& of)
        : evaluator(of.computation_.view(), of.layout(), of.options_) {}

    ObservationEvaluator evaluator;
    LargeVector<double> points;
  };
  void MoveTo(const double* step, double e, Place* place) const;
  double Dot(const ObservationRows& rows, int row, int point, const double* a) const;
  void AddRows(const ObservationRows& rows, const double* by_residual, int point, double* cameras,
               double* points) const;
  template <typename Visit>
  void ForObservations(const Visit& visit) const;
  template <typename Visit>
  void ForFactors(const ObservationEvaluator& evaluator, const double* points,
                  const Visit& visit) const;
  void AddFactorRows(const double* a, double e, AdjointRows* found) const;
  void ClearHeld(double* gradient) const;
  /// A point that FactorizeExactly has eliminated.
  struct Eliminated {
    int point;
    size_t first_block;  ///< in kept_blocks_
    size_t first_row;    ///< in kept_y_
    double inverse[9];   ///< V^-1
  };
  bool FactorizeExactly();
  template <typename Visit>
  void ForKept(int num_threads, const Visit& visit) const;

  const SolveOptions options_;
  const CovarianceOptions wanted_;
  CovarianceComputation computation_;
  AdjustmentProblem all_;  ///< the problem about its centre, with all factors
  std::vector<ChartedFactor> factors_;
  Place ahead_, behind_;
  bool is_exact_ = false;
  LargeVector<Eliminated> kept_;  ///< if the factor is exact
  LargeVector<int> kept_blocks_;  ///< blocks of the layout that see each of them
  LargeVector<double> kept_y_;    ///< rows of Y of each of them, 3 numbers per unknown
};

}  // namespace bundle
