#include "core/linear/conjugate_gradients.h"

/// Conjugate gradients as Ceres' ITERATIVE_SCHUR runs them inside Levenberg-Marquardt: from x = 0,
/// with 0 to 500 iterations, until the quadratic model Q(x) = x^T S x - 2 b^T x gains little,
///
///   i (Q_i - Q_{i-1}) / Q_i < eta   (Nash and Sofer, 1990),
///
/// with Q = -x^T (b + r) from the residual r = b - S x, which is recomputed in every 10th
/// iteration.
///
/// Ceres iterates on the scaled unknowns y = C^-1 x, C = diag(scale): S' = C S C, b' = C b. With r'
/// = C r, z' = C^-1 z and p' = C^-1 p every inner product is the same in both: r'^T z' = r^T z,
/// p'^T S' p' = p^T S p, and so is Q, provided that z = C M'^-1 C r. M consists of blocks of S or
/// U, hence M' = C M C and z = M^-1 r: the scaling cancels. It remains only with the identity as
/// preconditioner, M' = I, z = C^2 r. So no vector is scaled here.
///
/// A residual that is exactly 0 also ends the iterations. In Ceres, the next step would be 0 / 0
/// and fail; rounding usually prevents this. Here, a single block with its exact inverse often
/// gives a residual of 0.
///
/// OpenBLAS, which factorises for preconditioners, uses one thread. Its rounding depends on the
/// number of threads, which may depend on the launcher, and conjugate gradients would amplify the
/// differences.
///
/// Products with S take nearly all of the time: one per iteration and one more every 10th; 6 with
/// the power series. S is a matrix, or implicit: a function that multiplies by it
/// (schur/implicit_product.cpp).

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <numeric>
#include <string>
#include <utility>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/linear_solver.h"
#include "core/linear/preconditioners.h"
#include "core/linear/symmetric_product.h"
#include "core/parallel/blas.h"
#include "core/parallel/thread_pool.h"

namespace bundle {
namespace {

using Status = LinearStatus;

constexpr int kMaxIterations = 500;       // Ceres' max_linear_solver_iterations
constexpr int kResidualResetPeriod = 10;  // Ceres' ConjugateGradientsSolver

double Dot(const std::vector<double>& a, const std::vector<double>& b) {
  return std::inner_product(a.begin(), a.end(), b.begin(), 0.0);
}

bool IsZero(const std::vector<double>& a) {
  return std::all_of(a.begin(), a.end(), [](double v) { return v == 0; });
}

bool IsUsable(double value) { return value != 0 && std::isfinite(value); }

class IterativeSolver final : public LinearSolver {
 public:
  IterativeSolver(const BlockStructure& structure, PreconditionerType preconditioner,
                  int num_threads, bool is_implicit)
      : structure_(structure),
        is_implicit_(is_implicit),
        product_(structure_, num_threads),
        preconditioner_(MakePreconditioner(preconditioner, structure_, &product_, num_threads)),
        max_iterations_(std::min(kMaxIterations, structure_.num_columns())),
        x_(structure_.num_columns()),
        r_(structure_.num_columns()),
        z_(structure_.num_columns()),
        p_(structure_.num_columns()),
        q_(structure_.num_columns()) {}

  bool NeedsCameraDiagonal() const override { return preconditioner_->NeedsCameraDiagonal(); }
  bool IsIterative() const override { return true; }
  bool NeedsProduct() const override { return is_implicit_; }
  void SetProduct(Product product) override { implicit_product_ = std::move(product); }
  bool NeedsGaugeDirections() const override { return preconditioner_->NeedsGaugeDirections(); }

  void ForgetValues() override { preconditioner_->ForgetValues(); }

 private:
  LinearSolution DoFactorize(BlockSystem* system, const std::vector<double>& scale) override {
    system_ = system;
    const ScopedBlasThreads blas_threads(1);
    if (preconditioner_->Update(*system, scale)) return {Status::kSuccess, 0, ""};
    return {Status::kFailure, 0, "The preconditioner is not positive definite."};
  }

  LinearSolution DoSolve(const double* rhs, int num_rhs, double eta, double* x) override {
    LinearSolution all{Status::kSuccess, 0, ""};
    const ScopedBlasThreads blas_threads(1);
    const auto n = static_cast<std::ptrdiff_t>(x_.size());
    for (int k = 0; k < num_rhs && all.status == Status::kSuccess; ++k) {
      b_.assign(rhs + k * n, rhs + (k + 1) * n);
      std::fill(x_.begin(), x_.end(), 0.0);
      LinearSolution one = Iterate(b_, eta * preconditioner_->ForcingFactor());
      std::copy(x_.begin(), x_.end(), x + k * n);
      one.num_iterations += all.num_iterations;
      all = std::move(one);
    }
    return all;
  }

  LinearSolution Iterate(const std::vector<double>& b, double eta) {
    if (IsZero(b)) return {Status::kSuccess, 0, "Convergence. |b| = 0."};
    r_ = b;
    double last_rho = 1;
    double last_model = 0;
    for (int i = 1;; ++i) {
      ThrowIfInterrupted();
      if (IsZero(r_)) return {Status::kSuccess, i, "Convergence. |r| = 0."};
      preconditioner_->Multiply(r_.data(), z_.data());
      const double rho = Dot(r_, z_);
      // An exact solution, for instance if S has a single block, which is its own preconditioner.
      // Ceres would fail here, but the rounding of its products with S nearly always avoids this
      // case.
      if (i > 1 && rho == 0) return {Status::kSuccess, i, "Convergence. r'z = 0."};
      const double beta = i == 1 ? 0 : rho / last_rho;
      if (!IsUsable(rho) || (i > 1 && !IsUsable(beta))) return Broken(i, "r'z", rho);
      for (size_t k = 0; k < p_.size(); ++k) p_[k] = z_[k] + (i == 1 ? 0 : beta * p_[k]);
      last_rho = rho;

      MultiplySystem(p_, &q_);
      const double curvature = Dot(p_, q_);
      if (curvature <= 0 || std::isinf(curvature)) {
        // Ceres keeps the current solution; the trust region accepts or rejects it.
        return {Status::kSuccess, i,
                "The reduced camera system is indefinite: p'Sp = " + std::to_string(curvature)};
      }
      const double alpha = rho / curvature;
      if (!std::isfinite(alpha)) return Broken(i, "p'Sp", curvature);
      Advance(b, alpha, i);

      const double model = Model(b);
      const double zeta = i * (model - last_model) / model;
      if (zeta < eta) {
        return {Status::kSuccess, i, "Convergence: zeta = " + std::to_string(zeta) + "."};
      }
      last_model = model;
      if (i >= max_iterations_) {
        return {Status::kSuccess, i, "Maximum number of iterations reached."};
      }
    }
  }

  void MultiplySystem(const std::vector<double>& x, std::vector<double>* y) {
    if (is_implicit_) return implicit_product_(x.data(), y->data());
    product_.Multiply(system_->values, x.data(), y->data());
  }

  /// x += alpha p, and the corresponding residual.
  void Advance(const std::vector<double>& b, double alpha, int iteration) {
    for (size_t k = 0; k < x_.size(); ++k) x_[k] += alpha * p_[k];
    if (iteration % kResidualResetPeriod == 0) {
      MultiplySystem(x_, &z_);
      for (size_t k = 0; k < x_.size(); ++k) r_[k] = b[k] - z_[k];
    } else {
      for (size_t k = 0; k < x_.size(); ++k) r_[k] -= alpha * q_[k];
    }
  }

  /// Q = x^T S x - 2 b^T x
  double Model(const std::vector<double>& b) const {
    double sum = 0;
    for (size_t k = 0; k < x_.size(); ++k) sum -= x_[k] * (b[k] + r_[k]);
    return sum;
  }

  static LinearSolution Broken(int iteration, const char* name, double value) {
    return {Status::kFailure, iteration,
            std::string("Conjugate gradients broke down: ") + name + " = " + std::to_string(value) +
                "."};
  }

  const BlockStructure structure_;
  const bool is_implicit_;
  Product implicit_product_;
  SymmetricProduct product_;
  std::unique_ptr<Preconditioner> preconditioner_;
  const int max_iterations_;
  const BlockSystem* system_ = nullptr;  ///< system of the last Factorize
  std::vector<double> b_, x_, r_, z_, p_, q_;
};

}  // namespace

std::unique_ptr<LinearSolver> MakeIterativeSolver(const BlockStructure& structure,
                                                  PreconditionerType preconditioner,
                                                  int num_threads, bool is_implicit) {
  return std::make_unique<IterativeSolver>(structure, preconditioner, num_threads, is_implicit);
}

}  // namespace bundle
