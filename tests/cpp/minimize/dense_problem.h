#pragma once

/// A LeastSquares out of dense matrices, each formula as `core/minimize/least_squares.h` has
/// it and the linear algebra that of Ceres' DENSE_QR.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/minimize/least_squares.h"
#include "minimize/classic_functions.h"
#include "support/dense_oracle.h"

namespace bundle {

class DenseProblem final : public LeastSquares {
 public:
  explicit DenseProblem(ClassicFunction function) : function_(std::move(function)) {
    const int num_parameters = static_cast<int>(function_.start.size());
    x_ = Eigen::Map<const Eigen::VectorXd>(function_.start.data(), num_parameters);
    r_.resize(function_.num_residuals);
    j_.resize(function_.num_residuals, num_parameters);
    x_ = Project(x_);
  }

  Linearization Linearize(double damping) override {
    function_.evaluate(x_, &r_, &j_);
    const Eigen::VectorXd gradient = j_.transpose() * r_;
    const Eigen::ArrayXd squared_norms = j_.colwise().squaredNorm();
    if (scale_.size() == 0) scale_ = 1 / (1 + squared_norms.sqrt());
    scaled_d_ = (squared_norms * scale_.square()).max(1e-6).min(1e32).sqrt();
    d_ = scaled_d_ / scale_;
    damping_ = damping;
    const Eigen::VectorXd projected = HasBounds() ? (x_ - Project(x_ - gradient)).eval() : gradient;
    return {r_.allFinite() && j_.allFinite(), r_.squaredNorm() / 2, 0, gradient.norm(),
            projected.lpNorm<Eigen::Infinity>()};
  }

  NewtonResult SolveNewton(double /*eta*/) override {
    const Eigen::Index m = j_.rows(), n = j_.cols();
    Eigen::MatrixXd lhs = Eigen::MatrixXd::Zero(m + n, n);
    lhs.topRows(m) = j_ * scale_.matrix().asDiagonal();
    lhs.bottomRows(n).diagonal() = scaled_d_ * std::sqrt(damping_);
    Eigen::VectorXd rhs = Eigen::VectorXd::Zero(m + n);
    rhs.head(m) = r_;
    q_ = -scale_ * oracle::SolveLeastSquares(lhs, rhs).array();
    if (!q_.allFinite()) return {LinearStatus::kFailure, 1, "not finite"};
    return {LinearStatus::kSuccess, 1, ""};
  }

  Candidate EvaluateNewtonStep() override { return Try(q_); }

  DoglegProducts Products() override {
    const Eigen::VectorXd gradient = j_.transpose() * r_;
    p_ = gradient.array() / d_.square();
    const Eigen::VectorXd dp = d_ * p_.array(), dq = d_ * q_.array(), jp = j_ * p_, jq = j_ * q_;
    return {dp.dot(dp), dp.dot(dq), dq.dot(dq), jp.dot(jp), jp.dot(jq), jq.dot(jq)};
  }

  Candidate EvaluateDoglegStep(double a, double b) override { return Try(a * p_ + b * q_); }

  void Accept() override { std::swap(x_, candidate_); }

  double StateNorm() const override { return x_.norm(); }

  bool HasBounds() const override { return !function_.lower.empty(); }

  StepLine LineAlongStep() override {
    return {step_.dot(j_.transpose() * r_), step_.lpNorm<Eigen::Infinity>()};
  }

  Candidate EvaluateAlongStep(double a) override {
    ++num_evaluations_along_steps;
    return Try(step_, a);
  }

  double SlopeAtCandidate() override {
    Eigen::VectorXd r(r_.size());
    Eigen::MatrixXd j(j_.rows(), j_.cols());
    function_.evaluate(candidate_, &r, &j);
    return step_.dot(j.transpose() * r);
  }

  const Eigen::VectorXd& x() const { return x_; }
  int num_evaluations_along_steps = 0;

 private:
  Eigen::VectorXd Project(const Eigen::VectorXd& x) const {
    Eigen::VectorXd projected = x;
    for (size_t k = 0; k < function_.lower.size(); ++k) {
      const auto i = static_cast<Eigen::Index>(k);
      projected[i] = std::min(std::max(x[i], function_.lower[k]), function_.upper[k]);
    }
    return projected;
  }

  Candidate Try(const Eigen::VectorXd& d, double a = 1) {
    step_ = d;
    candidate_ = Project(x_ + a * d);
    Eigen::VectorXd r(r_.size());
    Eigen::MatrixXd j(j_.rows(), j_.cols());
    function_.evaluate(candidate_, &r, &j);
    const Eigen::VectorXd jd = j_ * d;
    return {-jd.dot(r_ + jd / 2), (candidate_ - x_).norm(), r.squaredNorm() / 2};
  }

  const ClassicFunction function_;
  Eigen::VectorXd x_, candidate_, step_, r_, p_, q_;
  Eigen::MatrixXd j_;
  Eigen::ArrayXd scale_, scaled_d_, d_;
  double damping_ = 0;
};

}  // namespace bundle
