#pragma once

/// Chordal cost of a pose graph, its gradient, and the blocks of its matrix Q (derived in
/// chordal_cost.cpp).

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/linear/fill_ordering.h"
#include "core/pose_graph/certificate.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

/// Matrix of one pose or edge, on the stack.
using SmallMatrix =
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::ColMajor, kMostRank, kMostRank>;

/// Edges of a chordal cost. A point is a matrix with a block [Y_i t_i] of dimension + 1 columns per
/// pose, and `dimension` rows, or more in a relaxation.
struct ChordalProblem {
  PoseGraph graph;        ///< poses are free
  FillOrdering ordering;  ///< elimination of its poses
  int num_threads = 1;
  std::vector<double> rotations;     ///< measured, num_edges x d x d, column-major
  std::vector<double> translations;  ///< measured, num_edges x d
  std::vector<double> kappa, tau;    ///< num_edges, above 0

  int dimension() const { return graph.dimension(); }
  int block() const { return graph.dimension() + 1; }
  int64_t num_poses() const { return graph.num_poses(); }
  SmallMatrix Rotation(int64_t edge) const;
  SmallMatrix Translation(int64_t edge) const;
};

/// The information of the view is not used; all poses are free.
ChordalProblem MakeChordalProblem(const PoseGraphView& view, const double* kappa, const double* tau,
                                  int num_threads);

/// Poses as a point with the first pose at the origin, which is the same for the cost.
Eigen::MatrixXd PointOfPoses(const ChordalProblem& problem, const double* poses);

/// Poses of a point of `dimension` rows, in the layout of a graph. Every block is a rotation. The
/// first pose moves to `first`.
std::vector<double> PosesOfPoint(const ChordalProblem& problem, const Eigen::MatrixXd& point,
                                 const double* first);

/// F of a point; `product`, if not nullptr, becomes X Q = (X M) M^T, half the gradient of F.
double ChordalCost(const ChordalProblem& problem, const Eigen::MatrixXd& point,
                   Eigen::MatrixXd* product);

/// Rounding error of F at a point: F below it is zero.
double ChordalRounding(const ChordalProblem& problem, const Eigen::MatrixXd& point);

/// True if the cost of each edge is at most this share of its kappa, or its rounding error.
bool HasExactEdges(const ChordalProblem& problem, const Eigen::MatrixXd& point, double share);

/// Lambda_i = sym(Y_i^T (X Q)_i) of all poses, d x d n.
Eigen::MatrixXd Multipliers(const ChordalProblem& problem, const Eigen::MatrixXd& point,
                            const Eigen::MatrixXd& product);

/// Diagonal blocks of Q, (d + 1) x (d + 1) n.
Eigen::MatrixXd DiagonalBlocks(const ChordalProblem& problem);

/// Block (i, j) of Q that an edge from i to j adds.
SmallMatrix PairBlock(const ChordalProblem& problem, int64_t edge);

/// Determinant of a 2 x 2 or 3 x 3 matrix.
double Determinant(const SmallMatrix& matrix);

/// Nearest matrix with orthonormal columns; with `proper`, the nearest rotation of a square matrix.
SmallMatrix NearestOrthonormal(const SmallMatrix& matrix, bool proper = false);

}  // namespace bundle
