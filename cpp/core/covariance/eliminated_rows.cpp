#include "core/covariance/eliminated_rows.h"

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>

#include "core/dense/decompositions.h"

namespace bundle {
namespace {

using Eigen::MatrixXd;

}  // namespace

Eigen::Map<const TwoRows> RowsByBlock(const ObservationRows& rows, int b) {
  return Eigen::Map<const TwoRows>(rows.jacobian[b], 2, rows.size[b]);
}

EliminatedRows::EliminatedRows(const PointBlocks& blocks, const PointAssembler& assembler,
                               const std::vector<double>& priors) {
  const MatrixXd rows = AllRows(blocks, assembler, priors, [](const ObservationRows&) {
    return Eigen::Matrix2d(Eigen::Matrix2d::Identity());
  });
  MatrixXd turned = rows.rightCols(blocks.begin.back());
  const Eigen::Index rank = std::min<Eigen::Index>(3 - blocks.num_null, rows.rows());
  root_.resize(3, rank);
  if (rank > 0) {
    MatrixXd known = MatrixXd::Identity(3, 3);
    if (blocks.num_null > 0) {  // eigenvalues of the projector ascend: 0 first
      known = DecomposeSymmetric(Eigen::Map<const Eigen::Matrix3d>(blocks.null_projector))
                  .vectors.leftCols(rank);
    }
    const MatrixXd r = ApplyQr(Multiply(rows.leftCols(3), known), &turned);
    root_ =
        r.topLeftCorner(rank, rank).triangularView<Eigen::Upper>().solve<Eigen::OnTheRight>(known);
  }
  top_ = turned.topRows(rank);
  rest_ = turned.bottomRows(rows.rows() - rank);
}

void EliminatedRows::Store(PointBlocks* blocks) const {
  Eigen::Map<Eigen::Matrix3d>(blocks->inverse) = Multiply(root_, root_.transpose());
  Eigen::Map<MatrixXd>(blocks->y.data(), 3, top_.cols()) = Multiply(root_, top_);
}

}  // namespace bundle
