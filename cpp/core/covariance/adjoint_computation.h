#pragma once

/// One computation of derivatives by the data, step by step (adjoint.h has the mathematics).

#include <cstdint>
#include <vector>

#include "core/covariance/adjoint.h"
#include "core/covariance/covariance_computation.h"
#include "core/model/problem_factors.h"

namespace bundle {

class AdjointComputation final : public AdjointSystem {
 public:
  AdjointComputation(const AdjustmentProblem& problem, const ProblemFactors* all,
                     const SolveOptions& options);

  int64_t size() const override { return num_unknowns() + 3 * int64_t{all_.num_points}; }
  int degrees() const override { return computation_.gauge_->degrees(); }
  std::vector<uint8_t> Held() const override;
  void Directions(double* n, double* of_sums) const override;
  void Solve(const double* y, double* a) override;
  std::vector<double> Gather(const InfluenceOptions& derivatives) const override;
  void Gradient(const double* step, double* gradient) override;
  void Product(const double* step, const double* a, double e, double* product,
               std::vector<double>* by_params) override;
  AdjointRows Along(const double* a) override;
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
  void MoveTo(const double* step, double e, const double* a, Place* place) const;
  double Dot(const ObservationRows& rows, int row, int point, const double* a) const;
  void AddRows(const ObservationRows& rows, const double* by_residual, int point, double* cameras,
               double* points) const;
  template <typename Visit>
  void ForObservations(const Visit& visit) const;
  template <typename Visit>
  void ForFactors(const Place& place, const Visit& visit) const;
  void ClearHeld(double* gradient) const;

  const SolveOptions options_;
  const CovarianceOptions wanted_;
  CovarianceComputation computation_;
  AdjustmentProblem all_;  ///< the problem about its centre, with all factors
  std::vector<ChartedFactor> factors_;
  Place here_, ahead_, behind_;
};

}  // namespace bundle
