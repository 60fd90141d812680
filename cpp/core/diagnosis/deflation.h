#pragma once

#include <Eigen/Core>
#include <vector>

namespace bundle {

/// Orthonormal directions that a search for eigenvectors excludes: those of pieces of the world,
/// each with its own unknowns, and others. All pieces together take the memory of one.
class Deflation {
 public:
  /// `piece`: of each unknown; -1: of none. `directions`: unknowns x a few; of each piece its own
  /// rows are taken, and made orthonormal.
  Deflation(std::vector<int> piece, const Eigen::MatrixXd& directions);

  /// Goes to those combinations z of the directions of each piece for which z^T A z is at most
  /// `tolerance`; `product` is A times directions().
  void KeepNull(const Eigen::MatrixXd& product, double tolerance);

  /// Takes more, orthonormal and orthogonal to all so far.
  void Add(const Eigen::MatrixXd& directions);

  /// Vectors of all pieces side by side. Columns that a piece does not have are zero.
  const Eigen::MatrixXd& directions() const { return of_pieces_; }
  int count() const;
  /// Takes the directions out of the columns of x.
  Eigen::MatrixXd Project(Eigen::MatrixXd x) const;
  /// All of them, a column each.
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
