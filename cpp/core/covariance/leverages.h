#pragma once

/// Residuals corrected for their leverage, and the curvature of the loss, for the sandwich
/// (sandwich.h).
///
/// The residual at the solution is smaller than the error. To first order of the Gauss-Newton
/// matrix G = sum J~^T J~ (observation_rows.h), r = (I - h) e with the leverage h_i = J~_i G^-1
/// J~_i^T (2 x 2). If all errors have the same variance,
///
///   E[r_i r_i^T] = s^2 (I - h_i),        r^_i = (I - h_i)^(-1/2) r_i    has again s^2 I
///
/// (HC2; J. G. MacKinnon and H. White, 1985). With the points eliminated, J~_i = (A_i, B_i) and C =
/// S^-1,
///
///   h = B V^-1 B^T + T C T^T,        T = A - B Y^T    (by the unknowns of the point's blocks).
///
/// Two rays to a point have four residuals, and three of them determine the point: I - h is nearly
/// of rank 1. Along directions in which I - h is below kFullLeverage, the residual says nothing
/// about its error. This part is left out of all sums.
///
/// The variance of all residuals rho' r under the loss, for the points, is
///
///   s^2 = sum ||rho' r||^2 / sum (2 - tr h)    over observations with rho' > 0.
///
/// Curvature. The Hessian of the cost is H = sum J~^T D J~ with D = I + beta r~ r~^T, along some
/// residuals negative. Evaluated at the residuals, it is no estimate of its expectation: residuals
/// are smaller than errors, and H^-1 of so few observations per point is far larger than the
/// inverse of the expectation. The sandwich therefore takes H = kappa G + the priors, with one
/// kappa <= 1. Without observation i, H^-1 is K / kappa in the units of its rows, K = h (I - h)^-1.
/// With it, by the rule of Sherman and Morrison, the observation has the leverage of its own D. As
/// the leverages of any H sum up to the number of parameters that it determines, kappa solves
///
///   sum_i tr[D K (kappa I + D K)^-1] = sum_i tr h_i,
///
/// with D = I at kappa = 1. For observations that determine little each, kappa is mean D / mean
/// rho' without P. J. Huber's correction for few observations (1973), and with it to first order.
/// With m the eigenvalues of K^(1/2) D K^(1/2), the terms are m / (kappa + m). The largest root is
/// taken. If no root makes all kappa + m positive, negative m count as 0. If even then there is
/// none above kLeastCurvature, the loss rejects too much for a covariance, and InputError is
/// thrown.

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "core/covariance/long_sums.h"
#include "core/covariance/reduced_system.h"

namespace bundle {

inline constexpr double kFullLeverage = 0.01;
inline constexpr double kLeastCurvature = 1e-3;

/// An observation that counts, with its residual r~, rho' and beta (observation_rows.h).
struct Leverage {
  int64_t observation;
  double residual[2];
  double weight, bend;
  Eigen::Matrix2d h;
  double along[2];                        ///< J~ a if it has no rows
  const ObservationRows* rows = nullptr;  ///< nullptr: they were computed several at a time
};
using LeverageVisitor = std::function<void(const Leverage&)>;

/// Covariances of a free point, and of the predictions of its observations.
class PointLeverages {
 public:
  virtual ~PointLeverages() = default;
  virtual Eigen::Matrix3d Covariance() const = 0;  ///< V^-1 + Y^T C Y
  /// The lower triangle of T C T^T of all observations, two rows each.
  virtual Eigen::MatrixXd OfCameras() const = 0;
};
using PointLeverageVisitor = std::function<void(int point, const PointBlocks&,
                                                const PointAssembler&, const PointLeverages&)>;

/// Options of ForLeverages.
struct LeverageOptions {
  bool without_h = false;
  bool of_points = false;  ///< PointLeverages are defined, even without h
  /// Free points that `of_point` visits, each before its observations, all of which have rows.
  std::vector<int> points = {};
  const double* adjoint = nullptr;  ///< a by unknown; zero for points
  /// Receives the covariances of points without rows, 9 numbers each, by C as it is; nullptr: none.
  double* covariances = nullptr;
};

/// Visits the observations of free points and then those of constant points, on all threads.
/// `inverse` empty: the values of the system are C (ReducedSystem::Invert). C may be any inverse of
/// a gauge: J N = 0.
void ForLeverages(const ReducedSystem& system, const LongMatrix& inverse,
                  const LeverageVisitor& of_observation, const PointLeverageVisitor& of_point = {},
                  const LeverageOptions& wanted = {});

struct CorrectedResiduals {
  std::vector<double> scores;  ///< r^, two numbers per observation; zero if it does not count
  double variance = 1;         ///< s^2; 1 without degrees of freedom
  double kappa = 1;            ///< exactly 1 without a loss
};

/// Returns the residuals of a system with this C, as for ForLeverages.
CorrectedResiduals CorrectForLeverage(const ReducedSystem& system, const LongMatrix& inverse);

}  // namespace bundle
