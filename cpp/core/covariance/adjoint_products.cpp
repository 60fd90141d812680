/// Part of AdjointComputation (adjoint_computation.h): products with the exact Hessian.

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/covariance/adjoint_computation.h"
#include "core/factors/loss.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

/// Calls add(column, place in a full vector) for the columns of a factor's Jacobian.
template <typename Add>
void ForColumns(const ChartedFactor& factor, const ParameterLayout& layout, const Add& add) {
  int column = 0;
  for (const int point : factor.unknowns().points) {
    for (int k = 0; k < 3; ++k) add(column++, layout.state_size() + 3 * int64_t{point} + k);
  }
  for (const int block : factor.unknowns().blocks) {
    const CameraBlock& of = layout.blocks()[block];
    for (int k = 0; k < of.size; ++k) add(column++, int64_t{of.offset} + k);
  }
}

/// sqrt(rho') / sigma, by which J is weighted in J~.
double RootWeight(const AdjustmentProblem& problem, const ObservationRows& rows) {
  const double* const sigma = problem.observation_sigma;
  return std::sqrt(rows.weight) / (sigma == nullptr ? 1 : sigma[rows.observation]);
}

}  // namespace

/// To the problem's values plus e times a step.
void AdjointComputation::MoveTo(const double* step, double e, Place* place) const {
  std::vector<double> state = layout().InitialState(all_);
  const size_t n = state.size();
  for (size_t j = 0; j < n; ++j) state[j] += e * step[j];
  place->points.assign(all_.points, all_.points + 3 * int64_t{all_.num_points});
  for (size_t k = 0; k < place->points.size(); ++k) place->points[k] += e * step[n + k];
  place->evaluator.MoveTo(state.data(), place->points.data(), system().held());
}

double AdjointComputation::Dot(const ObservationRows& rows, int row, int point,
                               const double* a) const {
  const double* const of_point = a + num_unknowns() + 3 * int64_t{point};
  double along = 0;
  for (int k = 0; k < 3; ++k) along += rows.point[3 * row + k] * of_point[k];
  for (int b = 0; b < rows.num_blocks; ++b) {
    const double* const from = a + layout().blocks()[rows.block[b]].offset;
    for (int k = 0; k < rows.size[b]; ++k) {
      along += rows.jacobian[b][row * rows.size[b] + k] * from[k];
    }
  }
  return along;
}

/// Adds J~^T r.
void AdjointComputation::AddRows(const ObservationRows& rows, const double* r, int point,
                                 double* cameras, double* points) const {
  for (int b = 0; b < rows.num_blocks; ++b) {
    double* const to = cameras + layout().blocks()[rows.block[b]].offset;
    const double* const j = rows.jacobian[b];
    for (int k = 0; k < rows.size[b]; ++k) to[k] += j[k] * r[0] + j[rows.size[b] + k] * r[1];
  }
  if (!layout().point_is_free(point)) return;
  double* const to = points + 3 * int64_t{point};
  for (int k = 0; k < 3; ++k) to[k] += rows.point[k] * r[0] + rows.point[3 + k] * r[1];
}

/// Calls visit(observation, point, thread) for all observations. Each point belongs to one thread.
template <typename Visit>
void AdjointComputation::ForObservations(const Visit& visit) const {
  const PointAssembler::Tracks& tracks = system().tracks();
  const int num_threads = system().num_threads();
  const auto first_of = [&](int64_t thread) {
    const int64_t wanted = RangeBegin(all_.num_observations, num_threads, thread);
    return std::lower_bound(tracks.begin.begin(), tracks.begin.end(), wanted) -
           tracks.begin.begin();
  };
  RunOnThreads(num_threads, [&](int64_t thread) {
    for (int64_t p = first_of(thread); p < first_of(thread + 1); ++p) {
      if (p % 256 == 0) ThrowIfInterrupted();
      for (int64_t k = tracks.begin[p]; k < tracks.begin[p + 1]; ++k) {
        visit(tracks.observation[k], static_cast<int>(p), static_cast<int>(thread));
      }
    }
  });
}

/// Calls visit(index, factor, rho, residual, Jacobian) for each factor with a value.
template <typename Visit>
void AdjointComputation::ForFactors(const ObservationEvaluator& evaluator, const double* points,
                                    const Visit& visit) const {
  for (size_t k = 0; k < factors_.size(); ++k) {
    const ChartedFactor& factor = factors_[k];
    std::vector<const double*> values;
    for (const int point : factor.unknowns().points) {
      values.push_back(points + 3 * int64_t{point});
    }
    std::vector<double> r(factor.num_residuals());
    std::vector<double> jacobian(r.size() * factor.num_columns() + 1);
    if (!factor.Evaluate(evaluator.states(), values.data(), r.data(), jacobian.data())) continue;
    double rho[3];
    ValueOfLoss(factor.factor().loss(), factor.factor().loss_scale(),
                SquaredNorm(r.data(), static_cast<int>(r.size())), rho);
    visit(k, factor, rho, r, jacobian);
  }
}

void AdjointComputation::Gradient(const double* step, double* gradient) {
  MoveTo(step, 1, &ahead_);
  const int n = num_unknowns();
  std::fill_n(gradient, size(), 0.0);
  std::vector<std::vector<double>> sums(system().num_threads(), std::vector<double>(n));
  ForObservations([&](int64_t i, int point, int thread) {
    ObservationRows rows;
    if (!ahead_.evaluator.Evaluate(i, &rows)) return;
    AddRows(rows, rows.residual, point, sums[thread].data(), gradient + n);
  });
  for (const std::vector<double>& of : sums) {
    for (int j = 0; j < n; ++j) gradient[j] += of[j];
  }
  ForFactors(ahead_.evaluator, ahead_.points.data(),
             [&](size_t, const ChartedFactor& factor, const double* rho,
                 const std::vector<double>& r, const std::vector<double>& jacobian) {
               const int width = factor.num_columns();
               ForColumns(factor, layout(), [&](int column, int64_t at) {
                 for (size_t row = 0; row < r.size(); ++row) {
                   gradient[at] += rho[1] * jacobian[row * width + column] * r[row];
                 }
               });
             });
  ClearHeld(gradient);
}

AdjointRows AdjointComputation::Product(const double* a, double e) {
  const ObservationEvaluator& here = system().evaluator();
  MoveTo(a, e, &ahead_);
  MoveTo(a, -e, &behind_);
  const int stride = all_.camera_params_stride, n = num_unknowns();
  const auto num_observations = static_cast<size_t>(all_.num_observations);
  AdjointRows found;
  found.product.assign(size(), 0.0);
  found.along.assign(2 * num_observations, 0.0);
  found.residuals.assign(2 * num_observations, 0.0);
  found.weights.assign(num_observations, 0.0);
  found.bends.assign(num_observations, 0.0);
  struct Sums {
    std::vector<double> cameras, params;
  };
  std::vector<Sums> sums(system().num_threads());
  for (Sums& of : sums) {
    of.cameras.assign(n, 0.0);
    of.params.assign(size_t(all_.num_cameras) * stride, 0.0);
  }
  ForObservations([&](int64_t i, int point, int thread) {
    Sums& to = sums[thread];
    const int camera = all_.image_camera[all_.observation_image[i]];
    const int num_params = all_.camera_models[camera]->num_params;
    ObservationRows rows;
    double local[2 * kMaxCameraParams];
    double* const params = &to.params[size_t(camera) * stride];
    if (!here.Evaluate(i, &rows, local)) return;
    const double* const r = rows.residual;
    double v[2] = {Dot(rows, 0, point, a), Dot(rows, 1, point, a)};
    std::copy_n(v, 2, &found.along[2 * i]);
    std::copy_n(r, 2, &found.residuals[2 * i]);
    found.weights[i] = rows.weight;
    found.bends[i] = rows.bend;
    if (rows.weight == 0) return;
    const double bend = rows.bend * (v[0] * r[0] + v[1] * r[1]);
    for (int row = 0; row < 2; ++row) v[row] += bend * r[row];
    AddRows(rows, v, point, to.cameras.data(), found.product.data() + n);
    for (int k = 0; k < num_params; ++k)
      params[k] += local[k] * v[0] + local[num_params + k] * v[1];
    double by_point[3] = {}, by_params[kMaxCameraParams] = {};  // small differences, summed first
    for (const Place* place : {&ahead_, &behind_}) {
      const double scale = RootWeight(all_, rows) / (place == &ahead_ ? 2 * e : -2 * e);
      const double scaled[2] = {scale * r[0], scale * r[1]};
      place->evaluator.AddTransposed(i, scaled, to.cameras.data(), by_params, by_point);
    }
    for (int k = 0; k < num_params; ++k) params[k] += by_params[k];
    if (!layout().point_is_free(point)) return;
    for (int k = 0; k < 3; ++k) found.product[n + 3 * size_t(point) + k] += by_point[k];
  });
  found.by_params.assign(size_t(all_.num_cameras) * stride, 0.0);
  for (const Sums& of : sums) {
    for (int j = 0; j < n; ++j) found.product[j] += of.cameras[j];
    for (size_t k = 0; k < of.params.size(); ++k) found.by_params[k] += of.params[k];
  }
  AddFactorRows(a, e, &found);
  ClearHeld(found.product.data());
  return found;
}

void AdjointComputation::AddFactorRows(const double* a, double e, AdjointRows* found) const {
  found->factor_begin.push_back(0);
  for (const ChartedFactor& factor : factors_) {
    found->factor_begin.push_back(found->factor_begin.back() + factor.num_residuals());
  }
  found->factor_along.assign(found->factor_begin.back(), 0.0);
  found->factor_residuals.assign(found->factor_begin.back(), 0.0);
  found->factor_weights.assign(factors_.size(), 0.0);
  found->factor_bends.assign(factors_.size(), 0.0);
  const auto add = [&](const ChartedFactor& factor, const std::vector<double>& jacobian,
                       const std::vector<double>& by_residual) {
    const int width = factor.num_columns();
    ForColumns(factor, layout(), [&](int column, int64_t at) {
      for (size_t row = 0; row < by_residual.size(); ++row) {
        found->product[at] += jacobian[row * width + column] * by_residual[row];
      }
    });
  };
  ForFactors(system().evaluator(), all_.points,
             [&](size_t k, const ChartedFactor& factor, const double* rho,
                 const std::vector<double>& r, const std::vector<double>& jacobian) {
               const double root = std::sqrt(rho[1]);
               const int first = found->factor_begin[k], width = factor.num_columns();
               std::vector<double> v(r.size());
               double along = 0;
               for (size_t row = 0; row < r.size(); ++row) {
                 ForColumns(factor, layout(), [&](int column, int64_t at) {
                   v[row] += jacobian[row * width + column] * a[at];
                 });
                 along += v[row] * r[row];
                 found->factor_along[first + row] = root * v[row];
                 found->factor_residuals[first + row] = root * r[row];
               }
               for (size_t row = 0; row < r.size(); ++row) {
                 v[row] = rho[1] * v[row] + 2 * rho[2] * along * r[row];
               }
               found->factor_weights[k] = rho[1];
               found->factor_bends[k] = rho[1] == 0 ? 0 : 2 * rho[2] / (rho[1] * rho[1]);
               add(factor, jacobian, v);
             });
  for (const Place* place : {&ahead_, &behind_}) {
    const double scale = 1 / (place == &ahead_ ? 2 * e : -2 * e);
    ForFactors(place->evaluator, place->points.data(),
               [&](size_t k, const ChartedFactor& factor, const double*,
                   const std::vector<double>& r, const std::vector<double>& jacobian) {
                 std::vector<double> scaled(r.size());
                 for (size_t row = 0; row < r.size(); ++row) {
                   scaled[row] = scale * std::sqrt(found->factor_weights[k]) *
                                 found->factor_residuals[found->factor_begin[k] + row];
                 }
                 add(factor, jacobian, scaled);
               });
  }
}

}  // namespace bundle
