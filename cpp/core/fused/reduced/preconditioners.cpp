/// Ceres' preconditioners for ITERATIVE_SCHUR, with U the camera side of the normal equations
/// (block diagonal, as no observation sees two cameras' blocks, or cut to that where one has a
/// block of intrinsics beside that of its pose) and S = U - W V^-1 W^T:
///
///   identity                      M = I for the scaled unknowns x / scale, hence M^-1 = scale^2
///   jacobi                        M = U
///   schur_jacobi                  M = the block diagonal of S
///   schur_power_series_expansion  M^-1 = sum_{i=0..5} (U^-1 (U - S))^i U^-1
///
/// and one that Ceres does not have, two_level (two_level.cpp). The series is the Neumann series of
/// S^-1 = (I - U^-1 (U - S))^-1 U^-1. Its terms follow from each other, t_{i+1} = U^-1 (U - S) t_i
/// = t_i - U^-1 S t_i, at one product with S each. Ceres stops it by number alone inside conjugate
/// gradients, so that M stays the same from one to the next.

#include "core/fused/reduced/preconditioners.h"

#include <algorithm>
#include <cstddef>
#include <vector>

#include "core/fused/reduced/block_diagonal_inverse.h"
#include "core/fused/reduced/two_level.h"

namespace bundle::fused {
namespace {

constexpr int kPowerSeriesTerms = 5;  // Ceres' max_num_spse_iterations

class Identity final : public Preconditioner {
 public:
  bool Update(const ReducedSystem& /*system*/, const std::vector<double>& scale) override {
    scale_ = scale;
    return true;
  }

  void Multiply(const double* r, double* z) override {
    for (size_t i = 0; i < scale_.size(); ++i) z[i] = scale_[i] * scale_[i] * r[i];
  }

 private:
  std::vector<double> scale_;
};

bool InvertCameraDiagonal(const ReducedStructure& structure, const ReducedSystem& system,
                          BlockDiagonalInverse* inverse) {
  for (int j = 0; j < structure.num_blocks(); ++j) {
    const double* block = &system.camera_diagonal[inverse->begin(j)];
    if (!inverse->Invert(j, block, structure.block_size(j))) return false;
  }
  return true;
}

class Jacobi final : public Preconditioner {
 public:
  explicit Jacobi(const ReducedStructure& structure) : structure_(structure), inverse_(structure) {}

  bool Update(const ReducedSystem& system, const std::vector<double>& /*scale*/) override {
    return InvertCameraDiagonal(structure_, system, &inverse_);
  }

  void Multiply(const double* r, double* z) override { inverse_.Multiply(r, z); }

  bool NeedsCameraDiagonal() const override { return true; }

 private:
  const ReducedStructure& structure_;
  BlockDiagonalInverse inverse_;
};

class SchurJacobi final : public Preconditioner {
 public:
  explicit SchurJacobi(const ReducedStructure& structure) : inverse_(structure) {}

  bool Update(const ReducedSystem& system, const std::vector<double>& /*scale*/) override {
    return inverse_.InvertDiagonal(system.values);
  }

  void Multiply(const double* r, double* z) override { inverse_.Multiply(r, z); }

 private:
  BlockDiagonalInverse inverse_;
};

class PowerSeries final : public Preconditioner {
 public:
  PowerSeries(const ReducedStructure& structure, SymmetricProduct* product)
      : structure_(structure),
        product_(product),
        inverse_(structure),
        term_(structure.num_columns()),
        product_of_term_(structure.num_columns()),
        change_(structure.num_columns()) {}

  bool Update(const ReducedSystem& system, const std::vector<double>& /*scale*/) override {
    system_ = &system;
    return InvertCameraDiagonal(structure_, system, &inverse_);
  }

  void Multiply(const double* r, double* z) override {
    inverse_.Multiply(r, term_.data());
    std::copy(term_.begin(), term_.end(), z);
    for (int i = 0; i < kPowerSeriesTerms; ++i) {
      product_->Multiply(system_->values, term_.data(), product_of_term_.data());
      inverse_.Multiply(product_of_term_.data(), change_.data());
      for (size_t k = 0; k < term_.size(); ++k) {
        term_[k] -= change_[k];
        z[k] += term_[k];
      }
    }
  }

  bool NeedsCameraDiagonal() const override { return true; }

 private:
  const ReducedStructure& structure_;
  SymmetricProduct* product_;
  BlockDiagonalInverse inverse_;
  const ReducedSystem* system_ = nullptr;
  std::vector<double> term_;
  std::vector<double> product_of_term_;
  std::vector<double> change_;
};

}  // namespace

std::unique_ptr<Preconditioner> MakePreconditioner(PreconditionerType preconditioner,
                                                   const ReducedStructure& structure,
                                                   SymmetricProduct* product, int num_threads) {
  switch (preconditioner) {
    case PreconditionerType::kIdentity:
      return std::make_unique<Identity>();
    case PreconditionerType::kJacobi:
      return std::make_unique<Jacobi>(structure);
    case PreconditionerType::kSchurPowerSeriesExpansion:
      return std::make_unique<PowerSeries>(structure, product);
    case PreconditionerType::kTwoLevel:
      return MakeTwoLevelPreconditioner(structure, num_threads);
    default:
      return std::make_unique<SchurJacobi>(structure);
  }
}

}  // namespace bundle::fused
