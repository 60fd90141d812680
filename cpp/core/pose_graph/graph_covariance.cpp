#include "core/pose_graph/graph_covariance.h"

/// Poses move by X Exp(d). At a minimum the covariance of all d is G = H^-1 with H = J^T W J, the
/// undamped normal equations without held poses; W includes the weights of a loss. Blocks of pairs
/// that share an edge are in the pattern of H, and therefore in the selected inverse of the factor
/// (linear/selected_inverse.cpp). Other pairs take d right-hand sides.
///
/// A relative pose B = X_i^-1 X_j moves by B Exp(d_ij) with d_ij = d_j - Ad d_i, Ad = Ad(B^-1), so
///
///   C_ij = G_jj - Ad G_ij - G_ij^T Ad^T + Ad G_ii Ad^T,
///
/// for any choice of the held pose.
///
/// Inner constraints. Moving a component by Exp(e) from the left, X to Exp(e) X = X Exp(Ad(X^-1)
/// e), changes no error: N with blocks N_i = Ad(X_i^-1) spans the null space of the component's H.
/// With one pose held, G (zero there) is a generalised inverse, and with N orthonormal
///
///   H^+ = P G P,  P = I - N N^T,    (H^+)_ij = G_ij - N_i Y_j^T - Y_i N_j^T + N_i (N^T Y) N_j^T,
///
/// Y = G N, is the pseudo-inverse: the covariance of least trace (W. Baarda's S-transformation).
/// Components share no unknown: one N of d columns, and one solve, is enough for all. Lever arms
/// are relative to the mean position of the component, which spans the same space and keeps digits.
///
/// Redundancy (W. Baarda: A testing procedure for use in geodetic networks, 1968). With A = U E the
/// whitened Jacobian w.r.t. d_ij (edge_kernel.h), the whitened error of a least-squares fit has the
/// covariance K = I - A C_ij A^T, where I leaves out rows without information. Its trace is the
/// redundancy of the edge, 0 if no other edge checks it, and r~^T K^+ r~ is distributed as chi2
/// with rank(K) degrees of freedom. Far from the constant pose, large numbers cancel in C_ij.
/// Rounding errors of these numbers count as unchecked. An edge whose K has only rounding errors is
/// not judged.
///
/// Poses are eliminated in the order of a solve (block_pattern_of_edges.h). In the selected
/// inverse, rounding errors grow from level to level down the elimination tree. FindInflation
/// therefore searches for variances that are below the variance with all other unknowns known.

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "core/dense/decompositions.h"
#include "core/pose_graph/edge_kernel.h"
#include "core/pose_graph/initialise.h"
#include "core/pose_graph/pose_graph_problem.h"

namespace bundle {
namespace {

/// Eigenvalue of K below which an error counts as unchecked, and rounding limit relative to the
/// terms of K that cancel.
constexpr double kUnchecked = 1e-6, kCancelled = 1e-13;
/// Rounding error of K above which an edge is not judged.
constexpr double kLost = 1e-2;

template <typename Group>
class GraphCovariance {
  static constexpr int kSize = Group::kTangent;
  static constexpr int kAmbient = Group::kAmbient;
  using Matrix = Eigen::Matrix<double, kSize, kSize, Eigen::RowMajor>;

 public:
  GraphCovariance(const PoseGraph& graph, HeldPoses held, const GraphCovarianceOptions& options)
      : graph_(graph),
        records_(PoseRecords<Group>(graph.poses)),
        held_(std::move(held)),
        options_(options),
        retraction_(Group::kManifold, kAmbient),
        block_of_(graph.num_poses(), -1) {
    if (std::all_of(graph.held.begin(), graph.held.end(), [](uint8_t h) { return h != 0; })) return;
    problem_ = MakePoseGraphProblem(graph, "auto", options.num_threads);
    const std::vector<int>& poses = problem_->pose_of_blocks();
    for (size_t b = 0; b < poses.size(); ++b) block_of_[poses[b]] = static_cast<int>(b);
  }

  GraphCovarianceOutput Run() {
    GraphCovarianceOutput output;
    if (problem_ != nullptr && !Factorize(&output)) return output;
    if (options_.inner) FindDirections();
    std::vector<Matrix> across;
    for (const auto& [a, b] : options_.relative) across.push_back(SolveAcross(a, b));
    if (problem_ != nullptr) {
      problem_->solver().InvertBlocks();
      FindInflation(&output);
    }
    for (size_t k = 0; k < across.size(); ++k) {
      const auto [a, b] = options_.relative[k];
      Append(Symmetric(Relative(a, b, across[k])), &output.relative);
      Append(UnderGauge(a, b, across[k]), &output.across);
    }
    for (int i = 0; i < static_cast<int>(graph_.num_poses()); ++i) {
      Append(Symmetric(UnderGauge(i, i, InverseBlock(i, i))), &output.poses);
    }
    if (options_.of_edges) {
      for (int64_t e = 0; e < graph_.num_edges(); ++e) TestEdge(e, &output);
    }
    return output;
  }

 private:
  static Matrix Symmetric(const Matrix& block) { return 0.5 * (block + block.transpose()); }

  static void Append(const Matrix& block, std::vector<double>* to) {
    to->insert(to->end(), block.data(), block.data() + kSize * kSize);
  }

  bool Factorize(GraphCovarianceOutput* output) {
    problem_->Linearize(0);
    const BlockStructure& s = problem_->structure();
    const BlockSystem& system = problem_->system();
    s.ForDiagonal([&](int, int64_t at) { diagonal_.push_back(system.values[at]); });
    const std::vector<double> rhs = system.rhs;
    const LinearSolution done = problem_->solver().Factorize(&problem_->system(), {});
    if (done.status != LinearStatus::kSuccess) {
      const int block = s.BlockOf(std::max(done.failed_minor - 1, 0));
      output->undetermined_pose = problem_->pose_of_blocks()[block];
      return false;
    }
    const std::vector<double> step = Solve(rhs, 1);
    for (size_t j = 0; j < step.size(); ++j) output->predicted_decrease += 0.5 * step[j] * rhs[j];
    return true;
  }

  std::vector<double> Solve(const std::vector<double>& rhs, int num_rhs) {
    std::vector<double> x(rhs.size());
    problem_->solver().Solve(rhs.data(), num_rhs, 0, x.data());
    return x;
  }

  void FindInflation(GraphCovarianceOutput* output) const {
    problem_->structure().ForDiagonal([&](int column, int64_t at) {
      const double inflation = problem_->system().values[at] * diagonal_[column];
      // Below 1 only by rounding; NaN or negative if no digit is left.
      output->inflation = inflation > 0.5 ? std::max(output->inflation, inflation)
                                          : std::numeric_limits<double>::infinity();
    });
  }

  /// G_ij of an edge, or G_ii.
  Matrix InverseBlock(int i, int j) const {
    const int bi = block_of_[i], bj = block_of_[j];
    if (bi < 0 || bj < 0) return Matrix::Zero();
    const BlockStructure& s = problem_->structure();
    const int column = std::min(bi, bj), row = std::max(bi, bj);
    const int64_t entry = s.Entry(column, row);
    Matrix block;
    for (int c = 0; c < kSize; ++c) {
      for (int r = 0; r < kSize; ++r) {
        const bool lower = row != column || r >= c;
        block(r, c) = problem_->system().values[lower ? s.ValueIndex(column, entry, r, c)
                                                      : s.ValueIndex(column, entry, c, r)];
      }
    }
    return bi == row ? block : Matrix(block.transpose());
  }

  /// G_ij of any two poses, computed by a solve.
  Matrix SolveAcross(int i, int j) {
    const int bi = block_of_[i], bj = block_of_[j];
    if (bi < 0 || bj < 0) return Matrix::Zero();
    const size_t size = diagonal_.size();
    std::vector<double> rhs(size * kSize, 0.0);
    for (int c = 0; c < kSize; ++c) rhs[c * size + kSize * size_t(bj) + c] = 1;
    const std::vector<double> x = Solve(rhs, kSize);
    Matrix block;
    for (int c = 0; c < kSize; ++c) {
      for (int r = 0; r < kSize; ++r) block(r, c) = x[c * size + kSize * size_t(bi) + r];
    }
    return block;
  }

  const double* Pose(int i) const { return graph_.poses.data() + int64_t{i} * kAmbient; }

  /// Ad(X_j^-1 X_i).
  Matrix AdjointBetween(int j, int i) const {
    double back[kAmbient];
    Matrix adjoint;
    retraction_.Between(Pose(j), Pose(i), back);
    retraction_.Adjoint(back, adjoint.data());
    return adjoint;
  }

  Matrix Relative(int i, int j, const Matrix& across) const {
    const Matrix adjoint = AdjointBetween(j, i);
    const Matrix moved = adjoint * across;
    return InverseBlock(j, j) - moved - moved.transpose() +
           adjoint * InverseBlock(i, i) * adjoint.transpose();
  }

  /// Computes N, Y and N^T Y. N is orthonormal in components without a fixed pose, zero in others.
  void FindDirections() {
    const auto num_poses = static_cast<size_t>(graph_.num_poses());
    const std::vector<int32_t> root =
        FindComponents(graph_.num_poses(), graph_.num_edges(), graph_.edges().data());
    std::vector<uint8_t> floats(num_poses, 0);
    for (const int32_t pose : held_.for_gauge) floats[root[pose]] = 1;
    n_.assign(num_poses, Matrix::Zero());
    y_.assign(num_poses, Matrix::Zero());
    k_.assign(num_poses, Matrix::Zero());
    of_component_ = root;
    constexpr int kFirst = kSize == 3 ? 0 : 4, kDimension = kSize == 3 ? 2 : 3;
    std::vector<double> middle(num_poses * 3, 0.0), count(num_poses, 0.0);
    for (size_t i = 0; i < num_poses; ++i) {
      count[root[i]] += 1;
      for (int k = 0; k < kDimension; ++k) {
        middle[3 * size_t(root[i]) + k] += Pose(static_cast<int>(i))[kFirst + k];
      }
    }
    std::vector<Matrix> gram(num_poses, Matrix::Zero());
    for (size_t i = 0; i < num_poses; ++i) {
      if (floats[root[i]] == 0) continue;
      double pose[kAmbient], origin[kAmbient] = {}, back[kAmbient];
      std::copy_n(Pose(static_cast<int>(i)), kAmbient, pose);
      for (int k = 0; k < kDimension; ++k) {
        pose[kFirst + k] -= middle[3 * size_t(root[i]) + k] / count[root[i]];
      }
      if (kSize == 6) origin[3] = 1;
      retraction_.Between(pose, origin, back);
      retraction_.Adjoint(back, n_[i].data());
      gram[root[i]] += n_[i].transpose() * n_[i];
    }
    for (size_t i = 0; i < num_poses; ++i) {
      if (floats[i] != 0 && size_t(root[i]) == i) gram[i] = InverseOfCholesky(gram[i]);
    }
    for (size_t i = 0; i < num_poses; ++i) n_[i] = n_[i] * gram[root[i]];
    if (problem_ == nullptr) return;
    const size_t size = diagonal_.size();
    std::vector<double> rhs(size * kSize);
    const auto visit = [&](auto&& each) {
      for (size_t i = 0; i < num_poses; ++i) {
        if (block_of_[i] < 0) continue;
        for (int r = 0; r < kSize; ++r) {
          for (int c = 0; c < kSize; ++c) {
            each(i, r, c, c * size + kSize * size_t(block_of_[i]) + r);
          }
        }
      }
    };
    visit([&](size_t i, int r, int c, size_t at) { rhs[at] = n_[i](r, c); });
    const std::vector<double> x = Solve(rhs, kSize);
    visit([&](size_t i, int r, int c, size_t at) { y_[i](r, c) = x[at]; });
    for (size_t i = 0; i < num_poses; ++i) k_[root[i]] += n_[i].transpose() * y_[i];
  }

  /// Block of H^+ or, without inner constraints, of G. `block`: G_ij.
  Matrix UnderGauge(int i, int j, const Matrix& block) const {
    if (!options_.inner) return block;
    return block - n_[i] * y_[j].transpose() - y_[i] * n_[j].transpose() +
           n_[i] * k_[of_component_[i]] * n_[j].transpose();
  }

  void TestEdge(int64_t e, GraphCovarianceOutput* output) const {
    const int i = graph_.edges()[2 * e], j = graph_.edges()[2 * e + 1];
    double residual[kSize], unused[kSize * kSize];
    Matrix a;
    EvaluateWhitened<Group>(graph_, e, records_.data(), residual, a.data(), unused);
    // The terms of A C_ij A^T that cancel, with variances alone: independent of the unit of length.
    const Matrix by_i = a * AdjointBetween(j, i);
    const double rounding =
        kCancelled * std::max(by_i.colwise().squaredNorm().dot(InverseBlock(i, i).diagonal()),
                              a.colwise().squaredNorm().dot(InverseBlock(j, j).diagonal()));
    if (!(rounding < kLost)) {
      output->edge_redundancy.push_back(std::numeric_limits<double>::quiet_NaN());
      output->edge_test.push_back(std::numeric_limits<double>::quiet_NaN());
      output->edge_rank.push_back(0);
      return;
    }
    const Matrix cofactor = a * Relative(i, j, InverseBlock(i, j)) * a.transpose();
    Eigen::MatrixXd k = -0.5 * (cofactor + cofactor.transpose());
    const double* root = RootOf<Group>(graph_, e);
    for (int r = 0; r < kSize; root += kSize - r++) {
      if (*root > 0) k(r, r) += 1;
    }
    const SymmetricEigen pairs = DecomposeSymmetric(k);
    double redundancy = 0, test = 0;
    int rank = 0;
    for (int m = 0; m < kSize; ++m) {
      if (!(pairs.values[m] > std::max(kUnchecked, rounding))) continue;
      double along = 0;
      for (int r = 0; r < kSize; ++r) along += pairs.vectors(r, m) * residual[r];
      redundancy += std::min(pairs.values[m], 1.0);
      test += along * along / pairs.values[m];
      ++rank;
    }
    output->edge_redundancy.push_back(redundancy);
    output->edge_test.push_back(test);
    output->edge_rank.push_back(rank);
  }

  const PoseGraph& graph_;
  const std::vector<double> records_;  ///< relative_pose.h
  const HeldPoses held_;
  const GraphCovarianceOptions& options_;
  const Retraction retraction_;
  std::unique_ptr<PoseGraphProblem> problem_;  ///< nullptr if all poses are held
  std::vector<int> block_of_;
  std::vector<double> diagonal_;  ///< diagonal of H
  std::vector<Matrix> n_, y_;     ///< N and Y per pose
  std::vector<Matrix> k_;         ///< per component, stored at its first pose
  std::vector<int32_t> of_component_;
};

}  // namespace

GraphCovarianceOutput ComputeGraphCovariance(PoseGraph graph, const uint8_t* fixed,
                                             const GraphCovarianceOptions& options) {
  HeldPoses held = HoldPoses(graph.num_poses(), graph.num_edges(), graph.edges().data(), fixed);
  graph.held = held.held;
  if (graph.dimension() == 2) return GraphCovariance<Se2>(graph, std::move(held), options).Run();
  return GraphCovariance<Se3>(graph, std::move(held), options).Run();
}

}  // namespace bundle
