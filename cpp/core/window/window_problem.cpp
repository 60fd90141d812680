#include "core/window/window_problem.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "core/minimize/damping.h"
#include "core/window/block_products.h"
#include "core/window/window_gauge.h"

namespace bundle {

WindowProblem::WindowProblem(const WindowView& view)
    : view_(view), x_(view), candidate_(view), landmarks_(view.num_landmarks) {
  WindowStructure made = MakeWindowStructure(view);
  place_ = std::move(made.place);
  structure_ = std::move(made.structure);
  solver_ = std::move(made.solver);
  fill_ratio_ = made.fill_ratio;
  const size_t columns = structure_.num_columns();
  system_.values.resize(structure_.num_values);
  for (std::vector<double>* v : {&system_.rhs, &gradient_, &scale_, &d_squared_, &newton_}) {
    v->resize(columns);
  }
  touched_at_.assign(view.num_blocks(), -1);
  x_norm_ = NormOf(x_);
}

WindowProblem::BlockPlace WindowProblem::Place(int a, int b) {
  const int column = std::min(place_[a], place_[b]), row = std::max(place_[a], place_[b]);
  const int64_t entry = structure_.Entry(column, row);
  return {system_.values.data() + structure_.ValueIndex(column, entry, 0, 0),
          structure_.panel_stride[column], place_[a] < place_[b]};
}

/// S_ab += J_a^T J_b, with rows x size matrices, row-major. Both triangles of a diagonal block are
/// added.
void WindowProblem::AddBlock(int a, int b, const double* ja, const double* jb, int rows) {
  const int na = view_.BlockSize(a), nb = view_.BlockSize(b);
  if (na == 0 || nb == 0) return;
  const BlockPlace place = Place(a, b);
  // S's lower triangle: the rows are those of the later block.
  if (place.transposed) {
    AddProduct(jb, nb, ja, na, rows, place.values, place.stride);
  } else {
    AddProduct(ja, na, jb, nb, rows, place.values, place.stride);
  }
}

void WindowProblem::AddGradient(int a, const double* j, const double* r, int rows) {
  const int n = view_.BlockSize(a);
  if (n == 0) return;
  double* const gradient = gradient_.data() + Column(a);
  for (int k = 0; k < rows; ++k) {
    for (int c = 0; c < n; ++c) gradient[c] += j[k * n + c] * r[k];
  }
}

void WindowProblem::AddVisual(const VisualRows& row) {
  const int blocks[] = {2 * row.anchor, 2 * row.observer, view_.camera_block(), view_.time_block()};
  const double* const by[] = {row.by.by_anchor, row.by.by_observer, row.by.by_camera,
                              row.by.by_time};
  for (int a = 0; a < 4; ++a) {
    AddGradient(blocks[a], by[a], row.r, 2);
    for (int b = a; b < 4; ++b) AddBlock(blocks[a], blocks[b], by[a], by[b], 2);
  }
}

void WindowProblem::AddInertial(const InertialRows& row) {
  constexpr int kRows = InertialRows::kRows;
  double parts[4][kRows * kMotionSize];
  const double* const both[] = {row.by_first, row.by_second};
  for (int s = 0; s < 2; ++s) {
    for (int r = 0; r < kRows; ++r) {
      const double* const from = both[s] + r * kStateTangent;
      std::copy_n(from, kPoseSize, parts[2 * s] + r * kPoseSize);
      std::copy_n(from + kPoseSize, kMotionSize, parts[2 * s + 1] + r * kMotionSize);
    }
  }
  for (int a = 0; a < 4; ++a) {
    AddGradient(2 * row.first + a, parts[a], row.r, kRows);
    for (int b = a; b < 4; ++b) {
      AddBlock(2 * row.first + a, 2 * row.first + b, parts[a], parts[b], kRows);
    }
  }
}

void WindowProblem::AddPrior(const WindowPrior& prior, const PriorForm& form) {
  const size_t n = form.gradient.size();
  size_t begin_a = 0;
  for (const int a : prior.blocks) {
    const int size_a = PriorBlockSize(a, view_.num_states);
    if (place_[a] >= 0) {
      for (int k = 0; k < size_a; ++k) gradient_[Column(a) + k] += form.gradient[begin_a + k];
    }
    size_t begin_b = 0;
    for (const int b : prior.blocks) {
      const int size_b = PriorBlockSize(b, view_.num_states);
      if (place_[a] >= 0 && place_[b] >= 0 && place_[a] >= place_[b]) {
        const BlockPlace place = Place(a, b);
        for (int c = 0; c < size_b; ++c) {
          double* const values = place.values + int64_t{c} * place.stride;
          for (int r = 0; r < size_a; ++r) {
            values[r] += form.information[(begin_a + r) * n + begin_b + c];
          }
        }
      }
      begin_b += size_b;
    }
    begin_a += size_a;
  }
}

Linearization WindowProblem::Linearize(double damping) {
  damping_ = damping > 0 ? std::max(damping, WindowGauge::kLeastDamping) : 0;
  Linearization result;
  LinearizeWindow(view_, x_, FactorSelection{}, &rows_);
  costs_ = rows_.costs;
  result.is_finite = rows_.is_finite;
  if (!result.is_finite) return result;
  std::fill(system_.values.begin(), system_.values.end(), 0.0);
  std::fill(gradient_.begin(), gradient_.end(), 0.0);
  for (const InertialRows& row : rows_.inertial) AddInertial(row);
  for (size_t k = 0; k < rows_.priors.size(); ++k) AddPrior(view_.priors[k], rows_.priors[k]);
  for (const VisualRows& row : rows_.visual) AddVisual(row);
  Damp(damping_);

  w_.clear();
  w_blocks_.clear();
  w_begin_.assign(1, 0);
  block_begin_.assign(1, 0);
  for (Landmark& landmark : landmarks_) {
    std::fill_n(landmark.hessian, 6, 0.0);
    std::fill_n(landmark.gradient, 3, 0.0);
  }
  for (size_t k = 0; k < system_.rhs.size(); ++k) system_.rhs[k] = -gradient_[k];
  size_t k = 0, next_anchor = 0;
  for (int l = 0; l < view_.num_landmarks; ++l) {
    touched_.clear();
    Landmark& landmark = landmarks_[l];
    for (; k < rows_.visual.size() && rows_.visual[k].landmark == l; ++k) {
      AddLandmark(rows_.visual[k], &landmark);
    }
    if (!touched_.empty()) AddAnchor(rows_.anchors[next_anchor++], &landmark);
    w_blocks_.insert(w_blocks_.end(), touched_.begin(), touched_.end());  // in the order of w
    Eliminate(&landmark);
    for (const int block : touched_) touched_at_[block] = -1;
    w_begin_.push_back(w_.size());
    block_begin_.push_back(w_blocks_.size());
  }
  is_scaled_ = true;

  result.cost = costs_.Total();
  double squared = 0;
  const auto look = [&](double g) {
    squared += g * g;
    if (!(std::abs(g) <= result.gradient_max_norm)) result.gradient_max_norm = std::abs(g);
  };
  for (const double g : gradient_) look(g);
  for (const Landmark& landmark : landmarks_) {
    for (const double g : landmark.gradient) look(g);
  }
  result.gradient_norm = std::sqrt(squared);
  result.is_finite = std::isfinite(result.cost) && std::isfinite(result.gradient_norm);
  return result;
}

void WindowProblem::Damp(double damping) {
  structure_.ForDiagonal([&](int column, int64_t index) {
    double& entry = system_.values[index];
    if (!is_scaled_) scale_[column] = JacobiScale(entry);
    d_squared_[column] = SquaredDamping(entry, scale_[column]);
    entry += damping * d_squared_[column];
  });
}

NewtonResult WindowProblem::SolveNewton(double eta) {
  const LinearSolution solution = solver_->Solve(&system_, scale_, eta, newton_.data());
  NewtonResult result{solution.status, solution.num_iterations, solution.message};
  if (result.status != LinearStatus::kSuccess) return result;
  TakeOutFreeDirections();
  for (size_t l = 0; l < landmarks_.size(); ++l) {
    Landmark& landmark = landmarks_[l];
    std::fill_n(landmark.newton, 3, 0.0);
    if (!landmark.is_regular) continue;
    double sum[3] = {landmark.solved[0], landmark.solved[1], landmark.solved[2]};
    const double* w = w_.data() + w_begin_[l];
    for (size_t k = block_begin_[l]; k < block_begin_[l + 1]; ++k) {
      const double* const q = newton_.data() + Column(w_blocks_[k]);
      const int n = view_.BlockSize(w_blocks_[k]);
      for (int i = 0; i < 3; ++i) {
        for (int c = 0; c < n; ++c) sum[i] += w[i * n + c] * q[c];
      }
      w += 3 * size_t(n);
    }
    const double* const h = landmark.hessian;
    double* const step = landmark.newton;
    step[2] = -sum[2] / h[5];
    step[1] = (-sum[1] - h[4] * step[2]) / h[3];
    step[0] = (-sum[0] - h[1] * step[1] - h[2] * step[2]) / h[0];
  }
  return result;
}

void WindowProblem::TakeOutFreeDirections() {
  const WindowGauge gauge(view_, x_);
  const auto columns = static_cast<int>(newton_.size());
  WindowGauge::Rows moves = WindowGauge::Rows::Zero(columns, WindowGauge::kDegrees);
  for (int block = 0; block < view_.camera_block(); ++block) {
    moves.middleRows(Column(block), view_.BlockSize(block)) = gauge.OfBlock(block);
  }
  Eigen::Matrix4d information = Eigen::Matrix4d::Zero();
  for (size_t k = 0; k < rows_.priors.size(); ++k) {
    information += gauge.Information(view_.priors[k], rows_.priors[k]);
  }
  const Eigen::Map<const Eigen::VectorXd> d_squared(d_squared_.data(), columns);
  Eigen::Map<Eigen::VectorXd> q(newton_.data(), columns);
  const WindowGauge::Rows weighted = d_squared.asDiagonal() * moves;
  const auto free = WindowGauge::Free(moves.transpose() * weighted, information);
  q -= moves * (free * (free.transpose() * (weighted.transpose() * q)));
}

double WindowProblem::Weighted() const {
  double sum = 0;
  for (size_t k = 0; k < newton_.size(); ++k) sum += Squared(newton_[k]) * d_squared_[k];
  for (const Landmark& l : landmarks_) {
    for (int i = 0; i < 3; ++i) sum += Squared(l.newton[i]) * l.d_squared[i];
  }
  return sum;
}

Candidate WindowProblem::EvaluateNewtonStep() {
  double along = 0, squared = 0;
  for (size_t k = 0; k < newton_.size(); ++k) {
    along += gradient_[k] * newton_[k];
    squared += Squared(newton_[k]);
  }
  for (size_t l = 0; l < landmarks_.size(); ++l) {
    for (int i = 0; i < 3; ++i) {
      const double step = landmarks_[l].newton[i];
      along += landmarks_[l].gradient[i] * step;
      squared += Squared(step);
      candidate_.points[3 * l + i] = x_.points[3 * l + i] + step;
    }
  }
  for (int i = 0; i < view_.num_states; ++i) {
    double d[kStateTangent];
    std::copy_n(newton_.data() + Column(2 * i), kPoseSize, d);
    std::copy_n(newton_.data() + Column(2 * i + 1), kMotionSize, d + kPoseSize);
    MoveState(x_.state(i), d, candidate_.states.data() + kStateNumbers * i);
  }
  if (view_.refine_camera) {
    MoveCamera(x_.camera_from_imu.data(), newton_.data() + Column(view_.camera_block()),
               candidate_.camera_from_imu.data());
  }
  if (view_.refine_time_offset) {
    candidate_.time_offset = x_.time_offset + newton_[Column(view_.time_block())];
  }
  candidate_costs_ = CostsOfWindow(view_, candidate_);
  candidate_norm_ = NormOf(candidate_);
  Candidate result;
  result.cost = candidate_costs_.Total();
  result.step_norm = std::sqrt(squared);
  result.model_cost_change = 0.5 * (damping_ * Weighted() - along);
  return result;
}

void WindowProblem::Accept() {
  std::swap(x_, candidate_);
  std::swap(costs_, candidate_costs_);
  std::swap(x_norm_, candidate_norm_);
}

double WindowProblem::NormOf(const WindowState& state) const {
  double sum = Squared(state.time_offset);
  for (const double value : state.states) sum += Squared(value);
  for (const double value : state.points) sum += Squared(value);
  for (const double value : state.camera_from_imu) sum += Squared(value);
  return std::sqrt(sum);
}

DoglegProducts WindowProblem::Products() {
  throw std::logic_error("windows take Levenberg-Marquardt's steps");
}

Candidate WindowProblem::EvaluateDoglegStep(double /*a*/, double /*b*/) {
  throw std::logic_error("windows take Levenberg-Marquardt's steps");
}

}  // namespace bundle
