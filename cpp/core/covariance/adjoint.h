#pragma once

/// Derivatives of a minimum with respect to the data of its problem.
///
/// Let f(x, d) be the cost, with data d such as measurements, and F its gradient w.r.t. the free
/// unknowns x. At a minimum F(x, d) = 0, so that by the implicit function theorem dx = -H^-1 F_d dd
/// with the exact Hessian H = F_x. For a function of x with the gradient y, the derivative w.r.t.
/// the data is therefore
///
///   -F_d^T a,        H a = y.
///
/// With the residual r~ and the rows J~ of a measurement (observation_rows.h), beta = 2 rho'' /
/// rho'^2 and the rows J(x), weighted as at x,
///
///   H a = sum J~^T (I + beta r~ r~^T) J~ a + (J(x + e a) - J(x - e a))^T r~ / 2e + O(e^2),
///
/// in the chart of the solver about the problem's values. The differences are second derivatives of
/// all that the solver differentiates: camera models, rigs, shutters, ties and factors of any kind.
/// Only J is differenced; r~ is constant. A difference of residuals would lose digits, because
/// rounding errors of pixels, relative to their change by e a, are 1e3 times those of J. Rows of
/// factors are weighted by sqrt(rho'), without the correction of the solvers.
///
/// **Factor.** H has the blocks of J~^T J~: of points, of cameras, and of the two that an
/// observation joins. The exact blocks, summed once, are eliminated like those of Gauss-Newton
/// (reduced_system.h), and the factor of their S gives H^-1. With u = sqrt(rho') r~ / s, an
/// observation adds to J~^T (I + beta r~ r~^T) J~
///
///   sum_k u_k d2 r_k = Z^T T Z + C,        T = d/dz (u^T dr/dz),
///
/// where z are the point P = Exp(w) q + t in the frame of the camera (q = R X), the parameters and
/// the twist. T is differenced; with g = u^T dr/dP, the other terms are
///
///   dP = -[q]x dw + dt + R dX,    C_ww = (g q^T + q g^T) / 2 - (g.q) I,    C_wX = -[g]x R.
///
/// At a minimum every V, and S with a fixed gauge, is positive definite. Elsewhere they may not
/// be; the factor is then that of J~^T J~. The factor lacks second derivatives of rigs and ties of
/// twists, and of factors. Callers therefore solve for a by conjugate gradients with it as
/// preconditioner: one product shows that nothing is missing.
///
/// Factors that couple a point with other unknowns, and functions of Python, are in no reduced
/// system. They are in the gradient only, and the preconditioner lacks them.
///
/// The free similarities N and the projectors P = I - N (E N)^T and P^T are those of free_gauge.h,
/// without the factors that the preconditioner lacks.

#include <cstdint>
#include <memory>
#include <vector>

#include "core/covariance/influence.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/scratch/large_vector.h"

namespace bundle {

/// The products of H and of the Jacobian's rows with a direction a.
struct AdjointRows {
  std::vector<double> product;  ///< H a
  /// The same derivative of the gradient of the observations w.r.t. all parameters of all cameras,
  /// num_cameras x stride.
  std::vector<double> by_params;
  LargeVector<double> along;      ///< num_observations x 2: J~ a; 0 if it does not count
  LargeVector<double> residuals;  ///< num_observations x 2: r~
  LargeVector<double> weights;    ///< num_observations: rho'
  LargeVector<double> bends;      ///< num_observations: beta
  /// Of each factor, from factor_begin[k] on; 0 without a value.
  std::vector<int> factor_begin;
  std::vector<double> factor_along, factor_residuals;
  std::vector<double> factor_weights, factor_bends;  ///< per factor
};

/// A full vector is that of the unknowns of the layout, followed by 3 coordinates per point, which
/// are zero for constant points.
class AdjointSystem {
 public:
  /// Linearises and factorises at the problem's values. `all`: the factors of the gradient;
  /// nullptr: none. Those of the problem are in the factorisation, too. Keeps references to both.
  /// `exact`: factorises H if it is positive definite. Throws as ComputeCovariance.
  static std::unique_ptr<AdjointSystem> Make(const AdjustmentProblem& problem,
                                             const ProblemFactors* all, const SolveOptions& options,
                                             bool exact);
  virtual ~AdjointSystem() = default;

  virtual int64_t size() const = 0;
  virtual int degrees() const = 0;
  /// True if H is factorised.
  virtual bool is_exact() const = 0;
  /// 1 for each camera parameter that is constant, also on a bound: num_cameras x stride.
  virtual std::vector<uint8_t> Held() const = 0;
  /// N and E N, size x degrees, column-major.
  virtual void Directions(double* n, double* of_sums) const = 0;
  /// a = (H + B B^T)^-1 y or (J~^T J~ + B B^T)^-1 y, with B as in FreeGauge::Hold.
  virtual void Solve(const double* y, double* a) = 0;
  /// y of derivatives with respect to poses, cameras and points.
  virtual std::vector<double> Gather(const InfluenceOptions& derivatives) const = 0;
  /// F at the problem's values plus `step`.
  virtual void Gradient(const double* step, double* gradient) = 0;
  virtual AdjointRows Product(const double* a, double e) = 0;
  /// The problem's values plus `step`, about the problem's origin.
  virtual SolveOutput Moved(const double* step) = 0;
};

}  // namespace bundle
