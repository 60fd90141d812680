#include "core/window/marginalize_window.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <string>

#include "core/dense/decompositions.h"
#include "core/error.h"
#include "core/geometry/rotation.h"
#include "core/window/window_elimination.h"
#include "core/window/window_prior.h"
#include "core/window/window_rows.h"

namespace bundle {
namespace {

void CheckLandmarksThatStay(const WindowView& view, const Marginalization& request) {
  for (int k = 0; k < view.num_observations; ++k) {
    const int l = view.landmarks[k];
    if (request.landmarks[l] != 0) continue;
    if (request.states[view.anchor_states[l]] != 0 || request.states[view.observers[k]] != 0) {
      throw InputError("landmark " + std::to_string(l) +
                       ": expected its elimination together with the states that observed it");
    }
  }
}

ColumnsOfBlocks PlaceBlocks(const WindowView& view, const Marginalization& request) {
  std::vector<uint8_t> touched(view.num_blocks(), 0);
  for (const WindowPrior& prior : view.priors) {
    for (const int block : prior.blocks) touched[block] = 1;
  }
  for (size_t i = 0; i < view.imu.size(); ++i) {
    if (request.imu[i] != 0 && view.imu[i] != nullptr) {
      std::fill_n(touched.begin() + 2 * static_cast<int64_t>(i), 4, uint8_t{1});
    }
  }
  for (int k = 0; k < view.num_observations; ++k) {
    const int l = view.landmarks[k];
    if (request.landmarks[l] == 0) continue;
    touched[2 * view.anchor_states[l]] = touched[2 * view.observers[k]] = 1;
    touched[view.camera_block()] = touched[view.time_block()] = 1;
  }
  ColumnsOfBlocks columns;
  columns.at.assign(view.num_blocks(), -1);
  const auto goes = [&](int b) { return b < view.camera_block() && request.states[b / 2] != 0; };
  for (const bool going : {true, false}) {
    for (int b = 0; b < view.num_blocks(); ++b) {
      if (touched[b] == 0 || view.BlockSize(b) == 0 || goes(b) != going) continue;
      columns.at[b] = columns.total();
      (going ? columns.num_gone : columns.num_kept) += view.BlockSize(b);
      if (!going) columns.kept.push_back(b);
    }
  }
  return columns;
}

/// The point of a block in an absorbed prior, or nullptr.
const double* PointOfOldPrior(const WindowView& view, int block) {
  for (const WindowPrior& prior : view.priors) {
    const auto at = std::find(prior.blocks.begin(), prior.blocks.end(), block);
    if (at != prior.blocks.end()) {
      return prior.points.data() + kStateNumbers * (at - prior.blocks.begin());
    }
  }
  return nullptr;
}

Eigen::MatrixXd MatrixOf(const WindowPrior& prior) {
  const auto columns =
      static_cast<int>(prior.num_rows == 0 ? 0 : prior.matrix.size() / prior.num_rows);
  using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  return Eigen::Map<const RowMajor>(prior.matrix.data(), prior.num_rows, columns);
}

/// Transforms from coordinates about the current state to those about the prior's points.
void MoveToPoints(const WindowView& view, const Marginalization& request, const WindowState& at,
                  WindowPrior* prior) {
  Eigen::MatrixXd m = MatrixOf(*prior);
  Eigen::VectorXd v = Eigen::Map<const Eigen::VectorXd>(prior->vector.data(), prior->num_rows);
  Eigen::VectorXd d0 = Eigen::VectorXd::Zero(m.cols());
  int begin = 0;
  for (const int block : prior->blocks) {
    double point[kStateNumbers];
    PointOfBlock(block, view.num_states, at, point);
    const double* const old = request.keep_points ? PointOfOldPrior(view, block) : nullptr;
    if (old != nullptr) {
      std::copy_n(old, kStateNumbers, point);
      BlockFromPoint(block, view.num_states, point, at, d0.data() + begin);
      const bool is_anchored = block < view.camera_block() && view.anchored[block / 2] != 0;
      if (HasRotation(block, view.num_states) && !is_anchored) {
        const double minus[3] = {-d0[begin], -d0[begin + 1], -d0[begin + 2]};
        Eigen::Matrix<double, 3, 3, Eigen::RowMajor> turn;
        LeftJacobian(minus, turn.data());
        m.middleCols(begin, 3) = m.middleCols(begin, 3) * turn;
        if (!prior->is_square_root) {
          m.middleRows(begin, 3) = turn.transpose() * m.middleRows(begin, 3);
          v.segment(begin, 3) = turn.transpose() * v.segment(begin, 3);
        }
      }
    }
    prior->points.insert(prior->points.end(), point, point + kStateNumbers);
    begin += view.BlockSize(block);
  }
  const Eigen::VectorXd moved = m * d0;
  if (prior->is_square_root) {
    v -= moved;
  } else {
    prior->constant += v.dot(d0) + 0.5 * d0.dot(moved);
    v += moved;
  }
  for (int r = 0; r < m.rows(); ++r) {
    prior->vector[r] = v[r];
    for (int c = 0; c < m.cols(); ++c) prior->matrix[size_t(r) * m.cols() + c] = m(r, c);
  }
}

/// A prior rounded to single precision.
void Round(WindowPrior* prior) {
  for (double& x : prior->matrix) x = static_cast<float>(x);
  for (double& x : prior->vector) x = static_cast<float>(x);
}

Eigen::MatrixXd InformationOf(const WindowPrior& prior) {
  const Eigen::MatrixXd m = MatrixOf(prior);
  return prior.is_square_root ? MultiplyTransposed(m, m) : m;
}

/// Factors that scale a diagonal to 1, where it is positive.
Eigen::VectorXd InverseRoots(Eigen::VectorXd diagonal) {
  for (double& x : diagonal) x = x > 0 ? 1 / std::sqrt(x) : 1;
  return diagonal;
}

double LeastCost(const WindowPrior& prior) {
  if (prior.num_rows == 0) return prior.constant;
  constexpr double kUnknown = 1e-11;  // for a unit diagonal: below this, a direction counts as free
  Eigen::MatrixXd lambda = InformationOf(prior);
  const Eigen::Map<const Eigen::VectorXd> v(prior.vector.data(), prior.num_rows);
  Eigen::VectorXd eta = v;
  double cost = prior.constant;
  if (prior.is_square_root) {
    eta = -MultiplyTransposed(MatrixOf(prior), v);
    cost += 0.5 * v.squaredNorm();
  }
  const Eigen::VectorXd scale = InverseRoots(lambda.diagonal());
  lambda = scale.asDiagonal() * lambda * scale.asDiagonal();
  lambda.diagonal().array() += kUnknown;
  eta = scale.cwiseProduct(eta);
  Eigen::MatrixXd d;
  if (!SolveByCholesky(lambda, eta, &d)) d = SolveSemidefinite(lambda, eta, kUnknown);
  return cost - 0.5 * eta.dot(d.col(0));
}

}  // namespace

MarginalizedWindow MarginalizeWindow(const WindowView& view, const Marginalization& request) {
  CheckLandmarksThatStay(view, request);
  const WindowState at(view);
  const ColumnsOfBlocks columns = PlaceBlocks(view, request);
  WindowRows rows;
  FactorSelection selection;
  selection.all = false;
  selection.landmarks = request.landmarks;
  selection.imu = request.imu;
  LinearizeWindow(view, at, selection, &rows);
  if (!rows.is_finite) {
    throw InputError(
        "landmarks: expected eliminated landmarks in front of the cameras that see them");
  }
  MarginalizedWindow result;
  result.prior.blocks = columns.kept;
  if (request.single_precision) {
    WindowElimination<float>(view, request, columns, rows, at).Run(&result);
  } else {
    WindowElimination<double>(view, request, columns, rows, at).Run(&result);
  }
  MoveToPoints(view, request, at, &result.prior);
  if (request.single_precision) Round(&result.prior);
  result.least_cost = LeastCost(result.prior);
  return result;
}

std::vector<double> SpectrumOfPrior(const WindowPrior& prior) {
  const Eigen::VectorXd values = EigenvaluesOfSymmetric(InformationOf(prior));
  return {values.data(), values.data() + values.size()};
}

std::vector<double> ScaledSpectrumOfPrior(const WindowPrior& prior) {
  Eigen::MatrixXd lambda = InformationOf(prior);
  const Eigen::VectorXd scale = InverseRoots(lambda.diagonal());
  lambda = scale.asDiagonal() * lambda * scale.asDiagonal();
  const Eigen::VectorXd values = EigenvaluesOfSymmetric(lambda);
  return {values.data(), values.data() + values.size()};
}

}  // namespace bundle
