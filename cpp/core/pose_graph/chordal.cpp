#include "core/pose_graph/chordal.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "core/error.h"
#include "core/linear/direct_solvers.h"
#include "core/linear/linear_solver.h"
#include "core/pose_graph/block_pattern_of_edges.h"
#include "core/pose_graph/nearest_rotation.h"
#include "core/pose_graph/relative_pose.h"

/// Chordal relaxation (Martinec and Pajdla, Robust rotation and translation estimation in multiview
/// reconstruction, 2007; Carlone, Tron, Daniilidis, Dellaert, Initialization techniques for 3D
/// SLAM, 2015). The first stage computes the rotations, with the chordal distance, which is linear:
///
///   minimise  sum k_ij || R_j - R_i Z_ij ||_F^2     over all d x d matrices R,
///
/// with k_ij the mean of the information's diagonal over the rotation. Each R is then replaced by
/// the nearest rotation. A row x of R and the same row of its neighbour satisfy x_j = Z^T x_i: one
/// factorisation with blocks of d is enough for all d rows. The second stage computes the
/// translations at these rotations:
///
///   minimise  sum || Z_R^T (R_i^T (t_j - t_i) - z_t) ||^2_Omega_tt,
///
/// with Omega_tt the information of the translation, in the frame of M (relative_pose.h).
///
/// Edges without information on the rotation would leave a rotation undetermined. So a billionth of
/// the mean weight is added to every diagonal.

namespace bundle {
namespace {

constexpr double kRegularization = 1e-9;

/// Rotations are d x d, row-major; `record` as in relative_pose.h.
void RotationOf(int dimension, const double* record, double* rotation) {
  if (dimension == 3) return QuaternionToRotation(record, rotation);
  rotation[0] = rotation[3] = record[3];
  rotation[1] = -record[4];
  rotation[2] = record[4];
}

const double* TranslationOf(int dimension, const double* pose) {
  return dimension == 3 ? pose + 4 : pose;
}

/// The linear least-squares problem of a stage: a block of d unknowns per free pose, and several
/// right-hand sides.
class ChordalStage {
 public:
  ChordalStage(const EdgePattern& pattern, int dimension, int num_threads)
      : pattern_(pattern), d_(dimension), structure_(pattern.structure) {
    solver_ = MakeSparseSolver(pattern.ordering, num_threads, &structure_);
  }

  /// Begins a stage.
  void Clear(int num_rhs) {
    num_rhs_ = num_rhs;
    system_.values.assign(structure_.num_values, 0.0);
    rhs_.assign(int64_t{structure_.num_columns()} * num_rhs, 0.0);
  }

  int BlockOf(int32_t pose) const { return pattern_.block_of[pose]; }

  /// H_ii += m, symmetric.
  void AddDiagonal(int block, const double* m) {
    double* const values = Values(block, structure_.column_begin[block]);
    for (int c = 0; c < d_; ++c) {
      for (int r = 0; r < d_; ++r) values[c * structure_.panel_stride[block] + r] += m[r * d_ + c];
    }
  }

  /// H_ij += m.
  void AddPair(int i, int j, const double* m) {
    const int column = std::min(i, j), row = std::max(i, j);
    double* const values = Values(column, structure_.Entry(column, row));
    for (int c = 0; c < d_; ++c) {
      for (int r = 0; r < d_; ++r) {
        values[c * structure_.panel_stride[column] + r] += i == row ? m[r * d_ + c] : m[c * d_ + r];
      }
    }
  }

  void AddRhs(int block, int rhs, int row, double value) { rhs_[Index(block, rhs, row)] += value; }

  void Solve() {
    double trace = 0;
    structure_.ForDiagonal([&](int, int64_t at) { trace += system_.values[at]; });
    const double little = kRegularization * trace / std::max(structure_.num_columns(), 1);
    structure_.ForDiagonal([&](int, int64_t at) { system_.values[at] += little; });
    solution_.resize(rhs_.size());
    LinearSolution found = solver_->Factorize(&system_, {});
    // One by one, which is faster for so few.
    for (int k = 0; k < num_rhs_ && found.status == LinearStatus::kSuccess; ++k) {
      const int64_t begin = int64_t{k} * structure_.num_columns();
      found = solver_->Solve(rhs_.data() + begin, 1, 0, solution_.data() + begin);
    }
    if (found.status != LinearStatus::kSuccess) {
      throw InputError("init: the linear system of the chordal relaxation has no solution (" +
                       found.message + ")");
    }
  }

  double Solution(int block, int rhs, int row) const { return solution_[Index(block, rhs, row)]; }

 private:
  double* Values(int column, int64_t entry) {
    return system_.values.data() + structure_.ValueIndex(column, entry, 0, 0);
  }
  size_t Index(int block, int rhs, int row) const {
    return size_t{static_cast<size_t>(rhs)} * structure_.num_columns() + structure_.offset[block] +
           row;
  }

  const EdgePattern& pattern_;
  const int d_;
  int num_rhs_ = 0;
  BlockStructure structure_;
  std::unique_ptr<LinearSolver> solver_;
  BlockSystem system_;
  std::vector<double> rhs_, solution_;
};

/// Data of an edge for the two stages.
struct ChordalEdge {
  int32_t i, j;
  double rotation[9];
  const double* translation;
  const double* information;
};

class Chordal {
 public:
  Chordal(const PoseGraph& graph, const double* information, int num_threads,
          const FillOrdering* known)
      : graph_(graph),
        information_(information),
        d_(graph.dimension()),
        tangent_(TangentSize(graph.dimension())),
        ambient_(AmbientSize(graph.dimension())),
        record_(graph.dimension() == 2 ? Se2::kRecord : Se3::kRecord),
        pattern_(PatternOfEdges(graph, graph.dimension(), "auto", known)),
        stage_(pattern_, graph.dimension(), num_threads),
        poses_(graph.poses) {}

  std::vector<double> Poses() {
    if (!pattern_.pose_of.empty()) {
      UpdateRecords();
      FindRotations();
      UpdateRecords();
      FindTranslations();
    }
    return std::move(poses_);
  }

 private:
  ChordalEdge EdgeAt(int64_t e) const {
    ChordalEdge edge{graph_.edges()[2 * e], graph_.edges()[2 * e + 1], {}, nullptr, nullptr};
    const double* const z = graph_.prepared->records.data() + e * record_;
    RotationOf(d_, z, edge.rotation);
    edge.translation = TranslationOf(d_, z);
    edge.information = information_ + e * tangent_ * tangent_;
    return edge;
  }

  void UpdateRecords() { records_ = d_ == 2 ? PoseRecords<Se2>(poses_) : PoseRecords<Se3>(poses_); }

  /// The mean of the diagonal entries of the rotation. These are the first three in space (SE(3)),
  /// and the last one in the plane (SE(2)).
  double RotationWeight(const double* information) const {
    if (d_ == 2) return information[8];
    return (information[0] + information[7] + information[14]) / 3;
  }

  void FindRotations() {
    stage_.Clear(d_);
    for (int64_t e = 0; e < graph_.num_edges(); ++e) {
      const ChordalEdge edge = EdgeAt(e);
      const double weight = RotationWeight(edge.information);
      const int i = stage_.BlockOf(edge.i), j = stage_.BlockOf(edge.j);
      double identity[9] = {}, coupling[9];
      for (int k = 0; k < d_; ++k) identity[k * d_ + k] = weight;
      for (int k = 0; k < d_ * d_; ++k) coupling[k] = -weight * edge.rotation[k];
      if (i >= 0) stage_.AddDiagonal(i, identity);
      if (j >= 0) stage_.AddDiagonal(j, identity);
      if (i >= 0 && j >= 0) stage_.AddPair(i, j, coupling);
      if ((i >= 0) != (j >= 0)) AddKnownRotation(edge, weight);
    }
    stage_.Solve();
    for (size_t b = 0; b < pattern_.pose_of.size(); ++b) {
      double matrix[9];
      for (int row = 0; row < d_; ++row) {
        for (int k = 0; k < d_; ++k) {
          matrix[row * d_ + k] = stage_.Solution(static_cast<int>(b), row, k);
        }
      }
      SetNearestRotation(d_, matrix, poses_.data() + int64_t{pattern_.pose_of[b]} * ambient_);
    }
  }

  /// x_j = Z^T x_i if one of the two is constant.
  void AddKnownRotation(const ChordalEdge& edge, double weight) {
    const int i = stage_.BlockOf(edge.i), j = stage_.BlockOf(edge.j);
    double known[9];
    RotationOf(d_, records_.data() + int64_t{i >= 0 ? edge.j : edge.i} * record_, known);
    for (int row = 0; row < d_; ++row) {
      for (int k = 0; k < d_; ++k) {
        double sum = 0;
        for (int l = 0; l < d_; ++l) {
          const double z = i >= 0 ? edge.rotation[k * d_ + l] : edge.rotation[l * d_ + k];
          sum += z * known[row * d_ + l];
        }
        stage_.AddRhs(std::max(i, j), row, k, weight * sum);
      }
    }
  }

  void FindTranslations() {
    stage_.Clear(1);
    for (int64_t e = 0; e < graph_.num_edges(); ++e) AddTranslation(EdgeAt(e));
    stage_.Solve();
    for (size_t b = 0; b < pattern_.pose_of.size(); ++b) {
      double* const pose = poses_.data() + int64_t{pattern_.pose_of[b]} * ambient_;
      for (int k = 0; k < d_; ++k) {
        pose[(d_ == 3 ? 4 : 0) + k] = stage_.Solution(static_cast<int>(b), 0, k);
      }
    }
  }

  /// With T = R_i Z_R and W = T Omega_tt T^T: H_ii, H_jj += W, H_ij -= W, and W R_i z_t to the
  /// right-hand side of j, its negative to that of i.
  void AddTranslation(const ChordalEdge& edge) {
    const int i = stage_.BlockOf(edge.i), j = stage_.BlockOf(edge.j);
    if (i < 0 && j < 0) return;
    const int first = d_ == 3 ? 3 : 0;
    double frame[9], turned[9], half[9] = {}, weight[9] = {}, negative[9], measured[3] = {};
    RotationOf(d_, records_.data() + int64_t{edge.i} * record_, frame);
    for (int r = 0; r < d_; ++r) {
      for (int c = 0; c < d_; ++c) {
        turned[r * d_ + c] = 0;
        for (int k = 0; k < d_; ++k) {
          turned[r * d_ + c] += frame[r * d_ + k] * edge.rotation[k * d_ + c];
        }
        measured[r] += frame[r * d_ + c] * edge.translation[c];
      }
    }
    for (int r = 0; r < d_; ++r) {
      for (int c = 0; c < d_; ++c) {
        for (int k = 0; k < d_; ++k) {
          half[r * d_ + c] +=
              turned[r * d_ + k] * edge.information[(first + k) * tangent_ + first + c];
        }
      }
    }
    for (int r = 0; r < d_; ++r) {
      for (int c = 0; c < d_; ++c) {
        for (int k = 0; k < d_; ++k) weight[r * d_ + c] += half[r * d_ + k] * turned[c * d_ + k];
        negative[r * d_ + c] = -weight[r * d_ + c];
      }
    }
    if (i >= 0) stage_.AddDiagonal(i, weight);
    if (j >= 0) stage_.AddDiagonal(j, weight);
    if (i >= 0 && j >= 0) stage_.AddPair(i, j, negative);
    const double* const t_i = TranslationOf(d_, poses_.data() + int64_t{edge.i} * ambient_);
    const double* const t_j = TranslationOf(d_, poses_.data() + int64_t{edge.j} * ambient_);
    for (int r = 0; r < d_; ++r) {
      for (int c = 0; c < d_; ++c) {
        const double w = weight[r * d_ + c];
        if (i >= 0) stage_.AddRhs(i, 0, r, w * ((j < 0 ? t_j[c] : 0) - measured[c]));
        if (j >= 0) stage_.AddRhs(j, 0, r, w * ((i < 0 ? t_i[c] : 0) + measured[c]));
      }
    }
  }

  const PoseGraph& graph_;
  const double* information_;
  const int d_, tangent_, ambient_, record_;
  const EdgePattern pattern_;
  ChordalStage stage_;
  std::vector<double> poses_, records_;  ///< relative_pose.h
};

}  // namespace

std::vector<double> ChordalPoses(const PoseGraph& graph, const double* information, int num_threads,
                                 const FillOrdering* known) {
  return Chordal(graph, information, num_threads, known).Poses();
}

}  // namespace bundle
