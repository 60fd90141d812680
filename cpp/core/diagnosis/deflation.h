#pragma once

#include <Eigen/Core>
#include <vector>

namespace bundle {

/// Orthonormal directions that a search for eigenvectors excludes. Some belong to one piece of the
/// world, with its own unknowns; others do not. All pieces together take the memory of one piece.
class Deflation {
 public:
  /// `piece`: piece of each unknown; -1: no piece. `directions`: unknowns x a few columns; each
  /// piece uses its own rows, made orthonormal.
  Deflation(std::vector<int> piece, const Eigen::MatrixXd& directions);

  /// Keeps only those combinations z of the directions of each piece for which z^T A z is at most
  /// `tolerance`; `product` is A times directions().
  void KeepNull(const Eigen::MatrixXd& product, double tolerance);

  /// Adds directions, orthonormal and orthogonal to all so far.
  void Add(const Eigen::MatrixXd& directions);

  /// The vectors of all pieces in common columns. Columns that a piece does not have are zero.
  const Eigen::MatrixXd& directions() const { return of_pieces_; }
  int count() const;
  /// Removes the directions from the columns of x.
  Eigen::MatrixXd Project(Eigen::MatrixXd x) const;
  /// All directions, a column each.
  Eigen::MatrixXd Dense() const;

 private:
  /// The rows of x that belong to a piece.
  Eigen::MatrixXd RowsOf(int piece, const Eigen::MatrixXd& x) const {
    return x(rows_[piece], Eigen::all);
  }

  std::vector<std::vector<int>> rows_;  ///< per piece
  std::vector<int> counts_;             ///< directions of each piece
  Eigen::MatrixXd of_pieces_;
  Eigen::MatrixXd others_;
};

}  // namespace bundle
