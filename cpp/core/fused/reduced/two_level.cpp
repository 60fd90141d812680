/// Two-level additive Schwarz:
///
///   M^-1 = D^-1 + Q A^-1 Q^T,      D the block diagonal of S,   A = Q^T S Q
///
/// D^-1 mends what is local to an image, the second term what is common to clusters of images
/// (coarse_space.cpp). A is factorised by CHOLMOD once a step. An iteration costs what Schur-Jacobi
/// costs and two triangular solves with the factor of A.
///
/// Iterations until Ceres' stopping rule, at the last steps before convergence: 1000 images along a
/// street 35 where Schur-Jacobi stops at the limit of 500, 1000 of a photo collection 28 instead of
/// 490; a fifth or less of the cameras' numbers changes little.
///
/// Where A is not positive definite, which rounding may make it, Schur-Jacobi is left.

#include "core/fused/reduced/two_level.h"

#include <memory>
#include <vector>

#include "core/fused/reduced/block_diagonal_inverse.h"
#include "core/fused/reduced/coarse_space.h"
#include "core/fused/reduced/sparse_cholesky.h"

namespace bundle::fused {
namespace {

class TwoLevel final : public Preconditioner {
 public:
  TwoLevel(const ReducedStructure& structure, int num_threads)
      : structure_(structure), num_threads_(num_threads), inverse_(structure) {}

  bool Update(const ReducedSystem& system, const std::vector<double>& /*scale*/) override {
    if (!inverse_.InvertDiagonal(system.values)) return false;
    if (coarse_ == nullptr) {
      coarse_ = std::make_unique<CoarseSpace>(structure_, system, num_threads_);
      factor_ = std::make_unique<SparseCholesky>(coarse_->structure());
      restricted_.resize(coarse_->structure().num_columns());
    }
    corrects_ = factor_->Factorize(coarse_->Project(system).data());
    return true;
  }

  void Multiply(const double* r, double* z) override {
    inverse_.Multiply(r, z);
    if (!corrects_) return;
    coarse_->Restrict(r, restricted_.data());
    const double* const correction = factor_->Solve(restricted_.data());
    if (correction != nullptr) coarse_->AddProlonged(correction, z);
  }

  bool NeedsSimilarities() const override { return true; }

 private:
  const ReducedStructure& structure_;
  const int num_threads_;
  BlockDiagonalInverse inverse_;
  std::unique_ptr<CoarseSpace> coarse_;
  std::unique_ptr<SparseCholesky> factor_;
  std::vector<double> restricted_;
  bool corrects_ = false;
};

}  // namespace

std::unique_ptr<Preconditioner> MakeTwoLevelPreconditioner(const ReducedStructure& structure,
                                                           int num_threads) {
  return std::make_unique<TwoLevel>(structure, num_threads);
}

}  // namespace bundle::fused
