#include "core/covariance/eliminated_rows.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <cstddef>

#include "core/dense/decompositions.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;

/// A curvature along the residual that is zero but for rounding.
constexpr double kRounding = 1e-12;

/// All rows of a point, three columns of it first.
MatrixXd AllRows(const PointBlocks& blocks, const PointAssembler& of,
                 const std::vector<double>& priors) {
  const auto num_priors = static_cast<Eigen::Index>(priors.size() / 3);
  const Eigen::Index num_observed = 2 * Eigen::Index{of.num_rows()};
  MatrixXd rows = MatrixXd::Zero(num_observed + num_priors, 3 + blocks.begin.back());
  for (int i = 0; i < of.num_rows(); ++i) {
    const ObservationRows& from = of.row(i);
    Eigen::Matrix2d root = Eigen::Matrix2d::Identity();
    if (of.is_second_order()) RootOfCurvature(from, &root);
    auto to = rows.middleRows(2 * Eigen::Index{i}, 2);
    to.leftCols(3) = root * Eigen::Map<const TwoRows>(from.point, 2, 3);
    for (int b = 0; b < from.num_blocks; ++b) {
      to.middleCols(3 + FirstColumn(blocks, from.block[b]), from.size[b]) +=
          root * RowsByBlock(from, b);
    }
  }
  rows.bottomLeftCorner(num_priors, 3) =
      Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>>(priors.data(),
                                                                                  num_priors, 3);
  return rows;
}

}  // namespace

bool RootOfCurvature(const ObservationRows& rows, Eigen::Matrix2d* root) {
  root->setIdentity();
  if (rows.bend == 0) return true;
  const Eigen::Map<const Eigen::Vector2d> r(rows.residual);
  const double along = 1 + rows.bend * r.squaredNorm();
  if (along < -kRounding) return false;
  *root += (std::sqrt(std::max(along, 0.0)) - 1) / r.squaredNorm() * r * r.transpose();
  return true;
}

Eigen::Map<const TwoRows> RowsByBlock(const ObservationRows& rows, int b) {
  return Eigen::Map<const TwoRows>(rows.jacobian[b], 2, rows.size[b]);
}

Eigen::Index FirstColumn(const PointBlocks& blocks, int block) {
  const auto at = std::lower_bound(blocks.blocks.begin(), blocks.blocks.end(), block);
  return blocks.begin[at - blocks.blocks.begin()];
}

EliminatedRows::EliminatedRows(const PointBlocks& blocks, const PointAssembler& assembler,
                               const std::vector<double>& priors) {
  const MatrixXd rows = AllRows(blocks, assembler, priors);
  MatrixXd turned = rows.rightCols(blocks.begin.back());
  const Eigen::Index rank = std::min<Eigen::Index>(3 - blocks.num_null, rows.rows());
  root_.resize(3, rank);
  if (rank > 0) {
    MatrixXd known = MatrixXd::Identity(3, 3);
    if (blocks.num_null > 0) {  // eigenvalues of the projector ascend: 0 first
      known = DecomposeSymmetric(Eigen::Map<const Eigen::Matrix3d>(blocks.null_projector))
                  .vectors.leftCols(rank);
    }
    const Eigen::HouseholderQR<MatrixXd> qr(Multiply(rows.leftCols(3), known));
    turned.applyOnTheLeft(qr.householderQ().adjoint());
    root_ = qr.matrixQR()
                .topLeftCorner(rank, rank)
                .triangularView<Eigen::Upper>()
                .solve<Eigen::OnTheRight>(known);
  }
  top_ = turned.topRows(rank);
  rest_ = turned.bottomRows(rows.rows() - rank);
}

void EliminatedRows::Store(PointBlocks* blocks) const {
  Eigen::Map<Eigen::Matrix3d>(blocks->inverse) = Multiply(root_, root_.transpose());
  Eigen::Map<MatrixXd>(blocks->y.data(), 3, top_.cols()) = Multiply(root_, top_);
}

}  // namespace bundle
