#pragma once

/// Robust losses, and the Gauss-Newton block of a residual with a loss.
///
/// The cost of a residual r(x) in R^m is f = 1/2 rho(s), s = ||r||^2. With J = dr/dx, rho' and
/// rho'' the derivatives of rho at s, and the second derivatives of r dropped as Gauss-Newton drops
/// them,
///
///   gradient = rho' J^T r,       block = J^T (rho' I + 2 rho'' r r^T) J.
///
/// A least-squares solver takes residuals and Jacobians only. Triggs et al., "Bundle Adjustment - A
/// Modern Synthesis" (2000), section 4.3, rescale both,
///
///   J~ = sqrt(rho') (I - alpha r r^T / s) J,       r~ = sqrt(rho') / (1 - alpha) r,
///
/// so that J~^T r~ is that gradient for every alpha, since (I - alpha r r^T / s) r = (1 - alpha) r,
/// and J~^T J~ = rho' J^T (I + (alpha^2 - 2 alpha) r r^T / s) J is that block if
///
///   1/2 alpha^2 - alpha - s rho'' / rho' = 0,
///   alpha = 1 - sqrt(D),   D = 1 + 2 s rho'' / rho'.
///
/// Across r the block's curvature is rho' >= 0, along r it is rho' D. D is negative if the loss is
/// concave as a function of ||r||: the block is indefinite and no real alpha exists. A D near zero
/// is also bad: r~ grows without bound, and J~ loses its rank along r.
///
/// Ceres (internal/ceres/corrector.cc) therefore takes alpha = 0 wherever rho'' <= 0, which leaves
///
///   J~ = sqrt(rho') J,     r~ = sqrt(rho') r,     J~^T J~ = rho' J^T J,
///
/// the block of iteratively reweighted least squares: same gradient, never indefinite. Every loss
/// that a solve offers has rho'' <= 0 everywhere. Only user-defined losses have a second-order
/// term.

#include <cmath>
#include <limits>
#include <optional>

namespace bundle {

/// ceres/loss_function.h has the formulae.
enum class LossType { kTrivial, kHuber, kSoftL1, kCauchy, kArctan, kTukey };

/// rho, rho', rho'' at s, in this order, as in ceres::LossFunction::Evaluate.
using LossValue = const double*;

/// The loss of this type at s = ||r||^2. The residual's norm is in units of `scale`, as in
/// options.h.
inline void ValueOfLoss(LossType type, double scale, double s, double rho[3]) {
  constexpr double kTiny = std::numeric_limits<double>::min();
  const double b = scale * scale;
  rho[0] = s, rho[1] = 1, rho[2] = 0;
  switch (type) {
    case LossType::kTrivial:
      return;
    case LossType::kHuber:
      if (s <= b) return;
      rho[0] = 2 * scale * std::sqrt(s) - b;
      rho[1] = std::fmax(kTiny, scale / std::sqrt(s));
      rho[2] = -rho[1] / (2 * s);
      return;
    case LossType::kSoftL1: {
      const double sum = 1 + s / b, root = std::sqrt(sum);
      rho[0] = 2 * b * (root - 1);
      rho[1] = std::fmax(kTiny, 1 / root);
      rho[2] = -rho[1] / (2 * b * sum);
      return;
    }
    case LossType::kCauchy: {
      const double sum = 1 + s / b;
      rho[0] = b * std::log(sum);
      rho[1] = std::fmax(kTiny, 1 / sum);
      rho[2] = -1 / (b * sum * sum);
      return;
    }
    case LossType::kArctan: {
      const double sum = 1 + s * s / (b * b);
      rho[0] = b * std::atan2(s, b);
      rho[1] = std::fmax(kTiny, 1 / sum);
      rho[2] = -2 * s / (b * b * sum * sum);
      return;
    }
    case LossType::kTukey: {
      const double rest = s <= b ? 1 - s / b : 0;
      rho[0] = b / 3 * (1 - rest * rest * rest);
      rho[1] = rest * rest;
      rho[2] = -2 / b * rest;
      return;
    }
  }
}

enum class SecondOrderTerm {
  kFull,     ///< Triggs'
  kClamped,  ///< Ceres': left out where rho'' <= 0
};

struct TriggsCorrection {
  double residual_scale;  ///< sqrt(rho') / (1 - alpha)
  double jacobian_scale;  ///< sqrt(rho')
  double alpha;
};

/// The correction at s = `squared_norm`; empty if it does not exist: if the block has no real
/// square root, or, with alpha = 1, the residual has no finite scale.
inline std::optional<TriggsCorrection> SolveTriggs(LossValue rho, double squared_norm,
                                                   SecondOrderTerm term) {
  const double scale = std::sqrt(rho[1]);
  if (squared_norm == 0 || (term == SecondOrderTerm::kClamped && rho[2] <= 0)) {
    return TriggsCorrection{scale, scale, 0};
  }
  const double discriminant = 1 + 2 * squared_norm * rho[2] / rho[1];
  if (!(discriminant > 0)) return std::nullopt;
  const double alpha = 1 - std::sqrt(discriminant);
  return TriggsCorrection{scale / (1 - alpha), scale, alpha};
}

inline double SquaredNorm(const double* residual, int rows) {
  double sum = 0;
  for (int i = 0; i < rows; ++i) sum += residual[i] * residual[i];
  return sum;
}

/// row[j] = r^T J e_j
inline double ResidualTimesColumn(const double* residual, const double* jacobian, int rows,
                                  int columns, int j) {
  double sum = 0;
  for (int i = 0; i < rows; ++i) sum += residual[i] * jacobian[i * columns + j];
  return sum;
}

/// Replaces r (rows) and J (rows x columns, row-major) by r~ and J~.
inline void ApplyTriggs(const TriggsCorrection& correction, int rows, int columns, double* residual,
                        double* jacobian) {
  const double squared_norm = SquaredNorm(residual, rows);
  const double share = squared_norm == 0 ? 0 : correction.alpha / squared_norm;
  for (int j = 0; j < columns; ++j) {
    const double along = ResidualTimesColumn(residual, jacobian, rows, columns, j);
    for (int i = 0; i < rows; ++i) {
      double& entry = jacobian[i * columns + j];
      entry = correction.jacobian_scale * (entry - share * along * residual[i]);
    }
  }
  for (int i = 0; i < rows; ++i) residual[i] *= correction.residual_scale;
}

/// J^T (rho' I + 2 rho'' r r^T) J, columns x columns, row-major.
inline void SecondOrderBlock(LossValue rho, int rows, int columns, const double* residual,
                             const double* jacobian, double* block) {
  for (int j = 0; j < columns; ++j) {
    const double along_j = ResidualTimesColumn(residual, jacobian, rows, columns, j);
    for (int k = 0; k < columns; ++k) {
      double product = 0;
      for (int i = 0; i < rows; ++i) {
        product += jacobian[i * columns + j] * jacobian[i * columns + k];
      }
      const double along_k = ResidualTimesColumn(residual, jacobian, rows, columns, k);
      block[j * columns + k] = rho[1] * product + 2 * rho[2] * along_j * along_k;
    }
  }
}

}  // namespace bundle
