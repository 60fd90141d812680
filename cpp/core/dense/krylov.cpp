#include "core/dense/krylov.h"

/// Block Lanczos with full orthogonalisation (Golub and Underwood 1977): the space
///
///   span { X, A X, A^2 X, ... },    X random, of b columns,
///
/// contains the extreme eigenvectors of A after few steps, up to b of one eigenvalue. Each new
/// block is made orthogonal to all earlier blocks, twice, so that rounding errors do not produce
/// copies of eigenvectors (Parlett: The Symmetric Eigenvalue Problem, 1980, chapter 13). With Q the
/// basis, the eigenpairs of the small Q^T A Q are those of A within the space (Rayleigh-Ritz); A Q
/// is kept, so that their residuals cost no product with A.
///
/// A space that A maps into itself ends the recurrence. If pairs are missing then, it grows by a
/// new random block. The last block is cut to the dimensions that are left: a space of all
/// dimensions has all pairs. A full space without converged pairs is replaced by the best half of
/// its Ritz vectors and the next block (thick restart: Wu and Simon 2000). All entries of Q^T A Q
/// are computed, so that no step depends on the form of the recurrence.
///
/// With n rows and k columns of Q, a step adds the columns of its block to Q^T A Q and reads Q five
/// times, 10 n k b flops. The pairs take 9 k^3 flops and read Q and A Q. They are therefore
/// computed only when the space has grown by a sixteenth.

#include <algorithm>
#include <cmath>
#include <random>

#include "core/dense/decompositions.h"

namespace bundle {
namespace {

/// A column that loses this share of its norm to the others is dependent on them.
constexpr double kDependent = 1e-10;
/// A column that loses this share of its norm to its own block takes rounding errors along the
/// basis with it.
constexpr double kCancelled = 0.1;
/// Growth of the space between two computations of the pairs.
constexpr double kGrowth = 17.0 / 16;

Eigen::MatrixXd RandomBlock(int rows, int columns, int seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal;
  Eigen::MatrixXd block(rows, columns);
  for (double& entry : block.reshaped()) entry = normal(random);
  return block;
}

/// The largest entry, rounded to a power of 2: a unit in which squares neither underflow nor
/// overflow. 1 if it is 0 or not finite.
double PowerOfTwoNear(const Eigen::MatrixXd& entries) {
  const double largest = entries.size() == 0 ? 0 : entries.cwiseAbs().maxCoeff();
  return largest > 0 && std::isfinite(largest) ? std::exp2(std::floor(std::log2(largest))) : 1;
}

}  // namespace

Eigen::MatrixXd Orthonormalize(const Eigen::MatrixXd& basis, Eigen::MatrixXd vectors) {
  Eigen::Index kept = 0;
  const Eigen::VectorXd before = vectors.colwise().norm();
  if (basis.cols() > 0) {
    for (int twice = 0; twice < 2; ++twice) {
      vectors -= Multiply(basis, MultiplyTransposed(basis, vectors));
    }
  }
  for (Eigen::Index j = 0; j < vectors.cols(); ++j) {
    Eigen::VectorXd column = vectors.col(j);
    const double entered = column.norm();
    const auto subtract_block = [&] {
      column -= vectors.leftCols(kept) * (vectors.leftCols(kept).transpose() * column);
    };
    for (int twice = 0; twice < 2; ++twice) subtract_block();
    for (int twice = 0; twice < 2 && !(column.norm() > kCancelled * entered); ++twice) {
      if (basis.cols() > 0) column -= basis * (basis.transpose() * column);
      subtract_block();
    }
    const double norm = column.norm();
    if (!(norm > kDependent * before[j])) continue;
    vectors.col(kept++) = column / norm;
  }
  return vectors.leftCols(kept);
}

EigenPairs FindLargest(int size, int wanted, int block, int max_dimension, double tolerance,
                       const BlockOperator& apply, int max_restarts) {
  max_dimension = std::min(max_dimension, size);
  Eigen::MatrixXd basis(size, 0), image(size, 0), projected(0, 0);
  // A first product projects the start onto the range of A, if A is singular.
  const Eigen::MatrixXd start = apply(RandomBlock(size, std::min(block, max_dimension), 1));
  const double unit = PowerOfTwoNear(start);
  Eigen::MatrixXd next = Orthonormalize(basis, start / unit);
  EigenPairs pairs;
  double next_pairs = 0;
  for (int restarts = 0, blocks = 1; next.cols() > 0;) {
    const Eigen::MatrixXd product = apply(next) / unit;
    const Eigen::Index before = basis.cols(), added = next.cols();
    basis.conservativeResize(Eigen::NoChange, before + added);
    image.conservativeResize(Eigen::NoChange, before + added);
    basis.rightCols(added) = next;
    image.rightCols(added) = product;
    // Its lower triangle is read.
    projected.conservativeResize(before + added, before + added);
    projected.bottomRows(added) = MultiplyTransposed(product, basis);

    const bool is_full = basis.cols() >= max_dimension;
    const bool is_last = is_full && (restarts >= max_restarts || max_dimension <= wanted);
    next = is_last ? Eigen::MatrixXd(size, 0) : Orthonormalize(basis, product);
    const auto dimension = static_cast<double>(basis.cols());
    if (next.cols() > 0 && !is_full && dimension < next_pairs) {
      next = next.leftCols(std::min(next.cols(), max_dimension - basis.cols())).eval();
      continue;
    }
    next_pairs = kGrowth * dimension;

    const SymmetricEigen small = DecomposeSymmetric(projected);
    const Eigen::Index count = std::min<Eigen::Index>(wanted, basis.cols());
    const Eigen::MatrixXd chosen = small.vectors.rightCols(count).rowwise().reverse();
    const Eigen::VectorXd values = small.values.tail(count).reverse();
    const Eigen::MatrixXd vectors = Multiply(basis, chosen);
    const Eigen::VectorXd residuals =
        (Multiply(image, chosen) - vectors * values.asDiagonal()).colwise().norm();
    pairs.converged =
        count == wanted && (residuals.array() <= tolerance * values.array().abs()).all();
    if (!pairs.converged && next.cols() == 0 && !is_full) {
      next = Orthonormalize(basis, apply(RandomBlock(size, block, ++blocks)) / unit);
    }
    if (pairs.converged || next.cols() == 0) {
      for (const double value : values) pairs.values.push_back(value * unit);
      pairs.vectors = vectors;
      break;
    }
    if (is_full) {
      ++restarts;
      const Eigen::Index kept = std::max<Eigen::Index>(count, basis.cols() / 2);
      const Eigen::MatrixXd best = small.vectors.rightCols(kept);
      basis = Multiply(basis, best);
      image = Multiply(image, best);
      projected = small.values.tail(kept).asDiagonal();
      next_pairs = 0;
    }
    next = next.leftCols(std::min(next.cols(), max_dimension - basis.cols())).eval();
  }
  return pairs;
}

}  // namespace bundle
