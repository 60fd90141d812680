#include "core/window/window_prior.h"

#include <algorithm>

#include "core/geometry/rotation.h"

namespace bundle {
namespace {

std::vector<double> CoordinatesOfPrior(const WindowPrior& prior, int num_states,
                                       const WindowState& at) {
  std::vector<double> d;
  double block[kStateTangent];
  for (size_t k = 0; k < prior.blocks.size(); ++k) {
    BlockFromPoint(prior.blocks[k], num_states, prior.points.data() + kStateNumbers * k, at, block);
    d.insert(d.end(), block, block + PriorBlockSize(prior.blocks[k], num_states));
  }
  return d;
}

/// M d + v for a square-root prior, M d - v for one in information form.
std::vector<double> Residuals(const WindowPrior& prior, const std::vector<double>& d) {
  std::vector<double> rows(prior.num_rows);
  const double sign = prior.is_square_root ? 1 : -1;
  for (int r = 0; r < prior.num_rows; ++r) {
    double sum = sign * prior.vector[r];
    const double* const row = prior.matrix.data() + size_t(r) * d.size();
    for (size_t c = 0; c < d.size(); ++c) sum += row[c] * d[c];
    rows[r] = sum;
  }
  return rows;
}

double Cost(const WindowPrior& prior, const std::vector<double>& d,
            const std::vector<double>& residuals) {
  double cost = prior.constant;
  if (prior.is_square_root) {
    for (const double x : residuals) cost += 0.5 * x * x;
  } else {
    // 1/2 d^T M d - v^T d = 1/2 d^T (M d - v) - 1/2 v^T d
    for (size_t c = 0; c < d.size(); ++c) cost += 0.5 * d[c] * (residuals[c] - prior.vector[c]);
  }
  return cost;
}

/// Calls visit(first coordinate, J_r^-1 of the rotation) for the rotations whose offset from the
/// point is not 0.
template <typename Visit>
void ForTurned(const WindowView& view, const WindowPrior& prior, const std::vector<double>& d,
               const Visit& visit) {
  int begin = 0;
  for (const int block : prior.blocks) {
    const bool is_anchored = block < view.camera_block() && view.anchored[block / 2] != 0;
    if (HasRotation(block, view.num_states) && !is_anchored) {
      const double minus[3] = {-d[begin], -d[begin + 1], -d[begin + 2]};
      if (minus[0] != 0 || minus[1] != 0 || minus[2] != 0) {
        double turn[9];
        InverseLeftJacobian(minus, turn);
        visit(begin, turn);
      }
    }
    begin += PriorBlockSize(block, view.num_states);
  }
}

/// row <- row T on three entries: for a row of M, or for a gradient as a row.
void TurnRow(const double turn[9], double* row) {
  double out[3];
  VectorMatrix3(row, turn, out);
  std::copy_n(out, 3, row);
}

}  // namespace

void PointOfBlock(int block, int num_states, const WindowState& at, double* point) {
  std::fill_n(point, kStateNumbers, 0.0);
  if (block == 2 * num_states) {
    std::copy_n(at.camera_from_imu.data(), 7, point);
  } else if (block == 2 * num_states + 1) {
    point[0] = at.time_offset;
  } else {
    std::copy_n(at.state(block / 2), kStateNumbers, point);
  }
}

void BlockFromPoint(int block, int num_states, const double* point, const WindowState& at,
                    double* d) {
  if (block == 2 * num_states) {
    CameraFromPoint(point, at.camera_from_imu.data(), d);
  } else if (block == 2 * num_states + 1) {
    d[0] = at.time_offset - point[0];
  } else {
    double local[kStateTangent];
    StateFrom(point, at.state(block / 2), local);
    std::copy_n(block % 2 == 0 ? local : local + kPoseSize, PriorBlockSize(block, num_states), d);
  }
}

double CostOfPrior(const WindowView& view, const WindowPrior& prior, const WindowState& at) {
  const std::vector<double> d = CoordinatesOfPrior(prior, view.num_states, at);
  return Cost(prior, d, Residuals(prior, d));
}

void RowsOfPrior(const WindowView& view, const WindowPrior& prior, const WindowState& at,
                 std::vector<double>* jacobian, std::vector<double>* residual) {
  const std::vector<double> d = CoordinatesOfPrior(prior, view.num_states, at);
  *residual = Residuals(prior, d);
  *jacobian = prior.matrix;
  ForTurned(view, prior, d, [&](int begin, const double* turn) {
    for (int r = 0; r < prior.num_rows; ++r) TurnRow(turn, jacobian->data() + r * d.size() + begin);
  });
}

PriorForm LinearizePrior(const WindowView& view, const WindowPrior& prior, const WindowState& at) {
  const std::vector<double> d = CoordinatesOfPrior(prior, view.num_states, at);
  const std::vector<double> residuals = Residuals(prior, d);
  const size_t n = d.size();
  PriorForm form;
  form.cost = Cost(prior, d, residuals);
  if (prior.is_square_root) {
    form.gradient.assign(n, 0.0);
    form.information.assign(n * n, 0.0);
    for (int k = 0; k < prior.num_rows; ++k) {
      const double* const row = prior.matrix.data() + k * n;
      for (size_t r = 0; r < n; ++r) {
        if (row[r] == 0) continue;  // M is trapezoidal
        form.gradient[r] += row[r] * residuals[k];
        double* const out = form.information.data() + r * n;
        for (size_t c = 0; c < n; ++c) out[c] += row[r] * row[c];
      }
    }
  } else {
    form.gradient = residuals;
    form.information = prior.matrix;
  }
  ForTurned(view, prior, d, [&](int begin, const double* turn) {
    TurnRow(turn, form.gradient.data() + begin);
    for (size_t r = 0; r < n; ++r) TurnRow(turn, form.information.data() + r * n + begin);
    // T^T from the left: the same for columns.
    for (size_t c = 0; c < n; ++c) {
      double column[3];
      for (int k = 0; k < 3; ++k) column[k] = form.information[(begin + k) * n + c];
      TurnRow(turn, column);
      for (int k = 0; k < 3; ++k) form.information[(begin + k) * n + c] = column[k];
    }
  });
  return form;
}

}  // namespace bundle
