/// Part of WindowProblem (window_problem.h): certainty of a window from its normal equations
/// without damping: eigenvalues, the covariance of the last state, and the expected cost of its IMU
/// factors.
///
/// With C = (J^T J)^-1 over all factors, residuals r of sigma 1 leave r - J C J^T r at the minimum.
/// So n rows J_f of one family of factors cost 1/2 (n - tr(J_f C J_f^T)) on average. This is close
/// to zero if the states follow these factors, and n / 2 if other factors determine the states.
/// With a wrong calibration, images and IMU contradict each other, and the cost is many times as
/// large.

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "core/dense/decompositions.h"
#include "core/geometry/rotation.h"
#include "core/window/window_problem.h"

namespace bundle {

std::vector<double> WindowProblem::ReducedSpectrum() {
  if (!structure_.dense || !Linearize(0).is_finite) return {};
  const int n = structure_.num_columns();
  Eigen::MatrixXd s = Eigen::Map<const Eigen::MatrixXd>(system_.values.data(), n, n);
  Eigen::VectorXd scale(n);
  for (int c = 0; c < n; ++c) {
    // After the elimination of the landmarks, a coordinate that only they determine has no
    // information.
    scale[c] = d_squared_[c] > 0 ? 1 / std::sqrt(d_squared_[c]) : 1;
  }
  for (int c = 0; c < n; ++c) {
    for (int r = c; r < n; ++r) s(r, c) *= scale[r] * scale[c];
  }
  const Eigen::VectorXd values = EigenvaluesOfSymmetric(s);
  return {values.data(), values.data() + n};
}

void WindowProblem::FixGauge() {
  const double* const first = view_.anchored[0] != 0 ? view_.anchors : x_.state(0);
  double rotation[9];
  QuaternionToRotation(first, rotation);
  const double* const up = rotation + 6;  // R^T e_z
  const BlockPlace place = Place(0, 0);
  double turn = 0;
  for (int k = 0; k < 3; ++k) turn = std::max(turn, d_squared_[Column(0) + k]);
  for (int c = 0; c < 3; ++c) {
    for (int r = 0; r < 3; ++r) place.values[int64_t{c} * place.stride + r] += turn * up[r] * up[c];
    place.values[int64_t{c + 3} * place.stride + c + 3] += d_squared_[Column(0) + 3 + c];
  }
}

bool WindowProblem::FactorizeUndamped(bool fix_gauge) {
  if (!Linearize(0).is_finite) return false;
  if (fix_gauge) FixGauge();
  return solver_->Factorize(&system_, scale_).status == LinearStatus::kSuccess;
}

std::vector<double> WindowProblem::CovarianceOfLastState(bool fix_gauge) {
  if (!FactorizeUndamped(fix_gauge)) return {};
  const int n = structure_.num_columns(), last = view_.num_states - 1;
  std::vector<int> columns;
  for (int c = 0; c < kPoseSize; ++c) columns.push_back(Column(2 * last) + c);
  for (int c = 0; c < kMotionSize; ++c) columns.push_back(Column(2 * last + 1) + c);
  std::vector<double> rhs(size_t(n) * kStateTangent, 0.0), x(rhs.size());
  for (int k = 0; k < kStateTangent; ++k) rhs[size_t(n) * k + columns[k]] = 1;
  if (solver_->Solve(rhs.data(), kStateTangent, 0, x.data()).status != LinearStatus::kSuccess) {
    return {};
  }
  std::vector<double> covariance;
  for (int r = 0; r < kStateTangent; ++r) {
    for (int c = 0; c < kStateTangent; ++c) covariance.push_back(x[size_t(n) * c + columns[r]]);
  }
  return covariance;
}

double WindowProblem::ExpectedImuCost(bool fix_gauge) {
  constexpr int kBoth = 2 * kStateTangent, kRows = InertialRows::kImuRows;
  if (!FactorizeUndamped(fix_gauge) || solver_->InvertBlocks().status != LinearStatus::kSuccess) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  double degrees = 0;
  double own[kMotionSize * kMotionSize], covariance[kBoth * kBoth];
  for (const InertialRows& row : rows_.inertial) {
    for (int a = 0, at_a = 0; a < 4; at_a += view_.BlockSize(a++)) {
      for (int b = 0, at_b = 0; b < 4; at_b += view_.BlockSize(b++)) {
        const int size_a = view_.BlockSize(a), size_b = view_.BlockSize(b), i = 2 * row.first;
        CopyBlock(structure_, system_.values, place_[i + a], place_[i + b], own);
        for (int r = 0; r < size_a; ++r) {
          std::copy_n(own + r * size_b, size_b, covariance + (at_a + r) * kBoth + at_b);
        }
      }
    }
    for (int k = 0; k < kRows; ++k) {
      double j[kBoth];
      std::copy_n(row.by_first + k * kStateTangent, kStateTangent, j);
      std::copy_n(row.by_second + k * kStateTangent, kStateTangent, j + kStateTangent);
      degrees += 1;
      for (int r = 0; r < kBoth; ++r) {
        double sum = 0;
        for (int c = 0; c < kBoth; ++c) sum += covariance[r * kBoth + c] * j[c];
        degrees -= j[r] * sum;
      }
    }
  }
  return 0.5 * degrees;
}

}  // namespace bundle
