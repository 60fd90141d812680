#include "core/pose_graph/chordal_cost.h"

/// Derivation. Poses X_i = (Y_i, t_i) and edges that measure R = R_ij, t = t_ij have the cost
///
///   F(X) = sum kappa || Y_j - Y_i R ||_F^2 + tau || t_j - t_i - Y_i t ||^2        (without 1/2).
///
/// It is quadratic in the matrix X = [Y_1 t_1 ... Y_n t_n]: F = || X M ||_F^2 = tr(X Q X^T) with
/// Q = M M^T. An edge gives the columns sqrt(kappa) (I at Y_j, -R at Y_i) and sqrt(tau) (1 at t_j,
/// -1 at t_i, -t at Y_i) of M, and so the blocks
///
///   Q_ii += [kappa I + tau t t^T   tau t]    Q_jj += [kappa I  0  ]    Q_ij += [-kappa R  -tau t]
///           [tau t^T               tau  ],           [0        tau],           [0         -tau  ]
///
/// X Q is computed as (X M) M^T, from the residuals X M: entries of Q cancel at small residuals.
///
/// If Y_i has r > d rows and orthonormal columns, F is the cost of the rank-r relaxation (Rosen,
/// Carlone, Bandeira, Leonard, SE-Sync: A certifiably correct algorithm for synchronization over
/// the special Euclidean group, IJRR 2019; Briales, Gonzalez-Jimenez, Cartan-Sync, RA-L 2017).

#include <algorithm>
#include <cmath>

#include "core/dense/decompositions.h"
#include "core/geometry/rotation.h"
#include "core/pose_graph/block_pattern_of_edges.h"

namespace bundle {

using Eigen::MatrixXd;

namespace {

constexpr double kEpsilon = 2.3e-16;

SmallMatrix RotationOfPose(int dimension, const double* pose) {
  SmallMatrix rotation(dimension, dimension);
  if (dimension == 2) {
    const double c = std::cos(pose[2]), s = std::sin(pose[2]);
    rotation << c, -s, s, c;
    return rotation;
  }
  const double norm = std::hypot(std::hypot(pose[0], pose[1]), std::hypot(pose[2], pose[3]));
  const double q[4] = {pose[0] / norm, pose[1] / norm, pose[2] / norm, pose[3] / norm};
  double rows[9];
  QuaternionToRotation(q, rows);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) rotation(r, c) = rows[3 * r + c];
  }
  return rotation;
}

SmallMatrix TranslationOfPose(int dimension, const double* pose) {
  const double* const t = dimension == 3 ? pose + 4 : pose;
  SmallMatrix translation(dimension, 1);
  for (int k = 0; k < dimension; ++k) translation(k, 0) = t[k];
  return translation;
}

/// Quaternion of a rotation: column of q q^T with the largest diagonal entry, normalised.
void QuaternionOfRotation(const SmallMatrix& m, double* q) {
  const double w = 1 + m(0, 0) + m(1, 1) + m(2, 2), x = 1 + m(0, 0) - m(1, 1) - m(2, 2);
  const double y = 1 - m(0, 0) + m(1, 1) - m(2, 2), z = 1 - m(0, 0) - m(1, 1) + m(2, 2);
  const double wx = m(2, 1) - m(1, 2), wy = m(0, 2) - m(2, 0), wz = m(1, 0) - m(0, 1);
  const double xy = m(0, 1) + m(1, 0), xz = m(0, 2) + m(2, 0), yz = m(1, 2) + m(2, 1);
  const double columns[4][4] = {{x, xy, xz, wx}, {xy, y, yz, wy}, {xz, yz, z, wz}, {wx, wy, wz, w}};
  const double largest = std::max({w, x, y, z});
  int best = 0;
  while (columns[best][best] < largest) ++best;
  double norm = 0;
  for (int k = 0; k < 4; ++k) norm += columns[best][k] * columns[best][k];
  norm = std::copysign(std::sqrt(norm), columns[best][3]);
  for (int k = 0; k < 4; ++k) q[k] = columns[best][k] / norm;
}

/// Residuals Y_j - Y_i R and t_j - t_i - Y_i t of an edge, each multiplied by its weight.
struct WeightedResiduals {
  SmallMatrix rotation, translation;
  double cost;
};

WeightedResiduals ResidualsOf(const ChordalProblem& problem, const MatrixXd& point, int64_t edge) {
  const int d = problem.dimension(), b = problem.block();
  const auto block = [&](int end) {
    return point.middleCols(int64_t{problem.graph.edges()[2 * edge + end]} * b, b);
  };
  const auto first = block(0), second = block(1);
  const SmallMatrix y = first.leftCols(d);
  WeightedResiduals found;
  found.rotation = second.leftCols(d) - y.lazyProduct(problem.Rotation(edge));
  found.translation =
      second.rightCols(1) - first.rightCols(1) - y.lazyProduct(problem.Translation(edge));
  const double kappa = problem.kappa[edge], tau = problem.tau[edge];
  found.cost = kappa * found.rotation.squaredNorm() + tau * found.translation.squaredNorm();
  found.rotation *= kappa;
  found.translation *= tau;
  return found;
}

}  // namespace

SmallMatrix ChordalProblem::Rotation(int64_t edge) const {
  const int d = dimension();
  return Eigen::Map<const MatrixXd>(rotations.data() + edge * d * d, d, d);
}

SmallMatrix ChordalProblem::Translation(int64_t edge) const {
  return Eigen::Map<const MatrixXd>(translations.data() + edge * dimension(), dimension(), 1);
}

ChordalProblem MakeChordalProblem(const PoseGraphView& view, const double* kappa, const double* tau,
                                  int num_threads) {
  ChordalProblem problem;
  problem.graph = MakePoseGraph(view, {});
  std::fill(problem.graph.held.begin(), problem.graph.held.end(), uint8_t{0});
  problem.ordering = OrderEdges(problem.graph, problem.block(), "auto");
  problem.num_threads = num_threads;
  problem.kappa.assign(kappa, kappa + view.num_edges());
  problem.tau.assign(tau, tau + view.num_edges());
  for (int64_t e = 0; e < view.num_edges(); ++e) {
    const double* const z = view.edges->measurements.data() + e * view.ambient();
    const SmallMatrix rotation = RotationOfPose(view.dimension(), z);
    const SmallMatrix translation = TranslationOfPose(view.dimension(), z);
    problem.rotations.insert(problem.rotations.end(), rotation.data(),
                             rotation.data() + rotation.size());
    problem.translations.insert(problem.translations.end(), translation.data(),
                                translation.data() + translation.size());
  }
  return problem;
}

MatrixXd PointOfPoses(const ChordalProblem& problem, const double* poses) {
  const int d = problem.dimension(), b = problem.block(), ambient = d == 2 ? 3 : 7;
  MatrixXd point(d, b * problem.num_poses());
  const SmallMatrix to_first = RotationOfPose(d, poses).transpose();
  const SmallMatrix origin = TranslationOfPose(d, poses);
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    const double* const pose = poses + i * ambient;
    const SmallMatrix apart = TranslationOfPose(d, pose) - origin;
    point.middleCols(i * b, d) = to_first.lazyProduct(RotationOfPose(d, pose));
    point.col(i * b + d) = to_first.lazyProduct(apart);
  }
  return point;
}

std::vector<double> PosesOfPoint(const ChordalProblem& problem, const MatrixXd& point,
                                 const double* first) {
  const int d = problem.dimension(), b = problem.block(), ambient = d == 2 ? 3 : 7;
  const SmallMatrix y = point.leftCols(d);
  const SmallMatrix turn = RotationOfPose(d, first).lazyProduct(y.transpose());
  const SmallMatrix origin = point.col(d), there = TranslationOfPose(d, first);
  std::vector<double> poses(problem.num_poses() * ambient);
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    const SmallMatrix own = point.middleCols(i * b, d), apart = point.col(i * b + d) - origin;
    const SmallMatrix rotation = turn.lazyProduct(own);
    const SmallMatrix translation = there + turn.lazyProduct(apart);
    double* const pose = poses.data() + i * ambient;
    if (d == 2) {
      pose[2] = std::atan2(rotation(1, 0), rotation(0, 0));
    } else {
      QuaternionOfRotation(rotation, pose);
    }
    for (int k = 0; k < d; ++k) pose[(d == 3 ? 4 : 0) + k] = translation(k, 0);
  }
  return poses;
}

double ChordalCost(const ChordalProblem& problem, const MatrixXd& point, MatrixXd* product) {
  const int d = problem.dimension(), b = problem.block();
  if (product != nullptr) product->setZero(point.rows(), point.cols());
  double cost = 0;
  for (int64_t e = 0; e < problem.graph.num_edges(); ++e) {
    const WeightedResiduals found = ResidualsOf(problem, point, e);
    cost += found.cost;
    if (product == nullptr) continue;
    const int64_t i = int64_t{problem.graph.edges()[2 * e]} * b;
    const int64_t j = int64_t{problem.graph.edges()[2 * e + 1]} * b;
    const SmallMatrix back = problem.Rotation(e).transpose(),
                      t = problem.Translation(e).transpose();
    product->middleCols(j, d) += found.rotation;
    product->col(j + d) += found.translation;
    product->middleCols(i, d) -=
        found.rotation.lazyProduct(back) + found.translation.lazyProduct(t);
    product->col(i + d) -= found.translation;
  }
  return cost;
}

namespace {

double RoundingOfEdge(const ChordalProblem& problem, const MatrixXd& point, int64_t e) {
  const int d = problem.dimension(), b = problem.block();
  const int64_t i = problem.graph.edges()[2 * e], j = problem.graph.edges()[2 * e + 1];
  const double squares = point.col(i * b + d).squaredNorm() + point.col(j * b + d).squaredNorm();
  return 16 * kEpsilon * kEpsilon * (d * problem.kappa[e] + problem.tau[e] * squares);
}

}  // namespace

double ChordalRounding(const ChordalProblem& problem, const MatrixXd& point) {
  double sum = 0;
  for (int64_t e = 0; e < problem.graph.num_edges(); ++e) sum += RoundingOfEdge(problem, point, e);
  return sum;
}

bool HasExactEdges(const ChordalProblem& problem, const MatrixXd& point, double share) {
  for (int64_t e = 0; e < problem.graph.num_edges(); ++e) {
    const double cost = ResidualsOf(problem, point, e).cost;
    if (!(cost <= std::max(share * problem.kappa[e], RoundingOfEdge(problem, point, e)))) {
      return false;
    }
  }
  return true;
}

MatrixXd Multipliers(const ChordalProblem& problem, const MatrixXd& point,
                     const MatrixXd& product) {
  const int d = problem.dimension(), b = problem.block();
  MatrixXd found(d, d * problem.num_poses());
  for (int64_t i = 0; i < problem.num_poses(); ++i) {
    const SmallMatrix y = point.middleCols(i * b, d).transpose(), g = product.middleCols(i * b, d);
    const SmallMatrix half = y.lazyProduct(g);
    found.middleCols(i * d, d) = 0.5 * (half + half.transpose());
  }
  return found;
}

MatrixXd DiagonalBlocks(const ChordalProblem& problem) {
  const int d = problem.dimension(), b = problem.block();
  MatrixXd blocks = MatrixXd::Zero(b, b * problem.num_poses());
  for (int64_t e = 0; e < problem.graph.num_edges(); ++e) {
    const double kappa = problem.kappa[e], tau = problem.tau[e];
    const SmallMatrix t = problem.Translation(e);
    auto first = blocks.middleCols(int64_t{problem.graph.edges()[2 * e]} * b, b);
    auto second = blocks.middleCols(int64_t{problem.graph.edges()[2 * e + 1]} * b, b);
    first.topLeftCorner(d, d) += tau * t.lazyProduct(t.transpose());
    first.topRightCorner(d, 1) += tau * t;
    first.bottomLeftCorner(1, d) += tau * t.transpose();
    for (auto* const block : {&first, &second}) {
      block->diagonal().head(d).array() += kappa;
      (*block)(d, d) += tau;
    }
  }
  return blocks;
}

SmallMatrix PairBlock(const ChordalProblem& problem, int64_t edge) {
  const int d = problem.dimension();
  SmallMatrix block = SmallMatrix::Zero(d + 1, d + 1);
  block.topLeftCorner(d, d) = -problem.kappa[edge] * problem.Rotation(edge);
  block.topRightCorner(d, 1) = -problem.tau[edge] * problem.Translation(edge);
  block(d, d) = -problem.tau[edge];
  return block;
}

double Determinant(const SmallMatrix& m) {
  if (m.rows() == 2) return m(0, 0) * m(1, 1) - m(0, 1) * m(1, 0);
  return m(0, 0) * (m(1, 1) * m(2, 2) - m(1, 2) * m(2, 1)) -
         m(0, 1) * (m(1, 0) * m(2, 2) - m(1, 2) * m(2, 0)) +
         m(0, 2) * (m(1, 0) * m(2, 1) - m(1, 1) * m(2, 0));
}

/// A (A^T A)^-1/2; a proper one turns the direction of the smallest singular value back.
SmallMatrix NearestOrthonormal(const SmallMatrix& matrix, bool proper) {
  const SmallMatrix gram = matrix.transpose().lazyProduct(matrix);
  SymmetricEigen eigen = DecomposeSymmetric(gram);
  Eigen::VectorXd inverse = eigen.values.cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
  if (proper && Determinant(matrix) < 0) inverse[0] = -inverse[0];
  const SmallMatrix scaled = eigen.vectors * inverse.asDiagonal();
  const SmallMatrix root = scaled.lazyProduct(eigen.vectors.transpose());
  return matrix.lazyProduct(root);
}

}  // namespace bundle
