#include "core/pose_graph/chordal.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <type_traits>
#include <utility>

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
/// factorisation with blocks of d is enough for all d rows. In the plane one row is enough: all Z
/// and the constant rotations have the form [a -b; b a], and so has the solution. The second stage
/// computes the translations at these rotations:
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
template <int kSize>
class ChordalStage {
 public:
  ChordalStage(const EdgePattern& pattern, int num_threads)
      : pattern_(pattern), structure_(pattern.structure) {
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
    for (int c = 0; c < kSize; ++c) {
      for (int r = 0; r < kSize; ++r)
        values[c * structure_.panel_stride[block] + r] += m[r * kSize + c];
    }
  }

  /// H_ij += m.
  void AddPair(int i, int j, const double* m) {
    const int column = std::min(i, j), row = std::max(i, j);
    double* const values = Values(column, structure_.Entry(column, row));
    for (int c = 0; c < kSize; ++c) {
      for (int r = 0; r < kSize; ++r) {
        values[c * structure_.panel_stride[column] + r] +=
            i == row ? m[r * kSize + c] : m[c * kSize + r];
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

template <int kSize>
class Chordal {
  using Group = std::conditional_t<kSize == 2, Se2, Se3>;
  static constexpr int kTangent = Group::kTangent, kAmbient = Group::kAmbient;
  static constexpr int kRecord = Group::kRecord;
  static constexpr int kRows = kSize == 2 ? 1 : 3;  ///< rows of the rotations that are solved for

 public:
  Chordal(const PoseGraph& graph, const double* information, int num_threads,
          const FillOrdering* known)
      : graph_(graph),
        information_(information),
        pattern_(PatternOfEdges(graph, kSize, "auto", known)),
        stage_(pattern_, num_threads),
        poses_(graph.poses) {}

  std::vector<double> Poses() {
    if (!pattern_.pose_of.empty()) {
      FindRotations();
      records_ = PoseRecords<Group>(poses_);
      FindTranslations();
    }
    return std::move(poses_);
  }

 private:
  ChordalEdge EdgeAt(int64_t e) const {
    ChordalEdge edge{graph_.edges()[2 * e], graph_.edges()[2 * e + 1], {}, nullptr, nullptr};
    const double* const z = graph_.prepared->records.data() + e * kRecord;
    RotationOf(kSize, z, edge.rotation);
    edge.translation = TranslationOf(kSize, z);
    edge.information = information_ + e * kTangent * kTangent;
    return edge;
  }

  /// The mean of the diagonal entries of the rotation. These are the first three in 3D (SE(3)),
  /// and the last one in 2D (SE(2)).
  double RotationWeight(const double* information) const {
    if (kSize == 2) return information[8];
    return (information[0] + information[7] + information[14]) / 3;
  }

  void FindRotations() {
    stage_.Clear(kRows);
    for (int64_t e = 0; e < graph_.num_edges(); ++e) {
      const ChordalEdge edge = EdgeAt(e);
      const double weight = RotationWeight(edge.information);
      const int i = stage_.BlockOf(edge.i), j = stage_.BlockOf(edge.j);
      double identity[9] = {}, coupling[9];
      for (int k = 0; k < kSize; ++k) identity[k * kSize + k] = weight;
      for (int k = 0; k < kSize * kSize; ++k) coupling[k] = -weight * edge.rotation[k];
      if (i >= 0) stage_.AddDiagonal(i, identity);
      if (j >= 0) stage_.AddDiagonal(j, identity);
      if (i >= 0 && j >= 0) stage_.AddPair(i, j, coupling);
      if ((i >= 0) != (j >= 0)) AddKnownRotation(edge, weight);
    }
    stage_.Solve();
    for (size_t b = 0; b < pattern_.pose_of.size(); ++b) {
      double matrix[9];
      for (int row = 0; row < kRows; ++row) {
        for (int k = 0; k < kSize; ++k) {
          matrix[row * kSize + k] = stage_.Solution(static_cast<int>(b), row, k);
        }
      }
      if (kSize == 2) matrix[2] = -matrix[1], matrix[3] = matrix[0];
      SetNearestRotation(kSize, matrix, poses_.data() + int64_t{pattern_.pose_of[b]} * kAmbient);
    }
  }

  /// x_j = Z^T x_i if one of the two is constant.
  void AddKnownRotation(const ChordalEdge& edge, double weight) {
    const int i = stage_.BlockOf(edge.i), j = stage_.BlockOf(edge.j);
    double record[kRecord], known[9];
    Group::Record(poses_.data() + int64_t{i >= 0 ? edge.j : edge.i} * kAmbient, record);
    RotationOf(kSize, record, known);
    for (int row = 0; row < kRows; ++row) {
      for (int k = 0; k < kSize; ++k) {
        double sum = 0;
        for (int l = 0; l < kSize; ++l) {
          const double z = i >= 0 ? edge.rotation[k * kSize + l] : edge.rotation[l * kSize + k];
          sum += z * known[row * kSize + l];
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
      double* const pose = poses_.data() + int64_t{pattern_.pose_of[b]} * kAmbient;
      for (int k = 0; k < kSize; ++k) {
        pose[(kSize == 3 ? 4 : 0) + k] = stage_.Solution(static_cast<int>(b), 0, k);
      }
    }
  }

  /// With T = R_i Z_R and W = T Omega_tt T^T: H_ii, H_jj += W, H_ij -= W, and W R_i z_t to the
  /// right-hand side of j, its negative to that of i.
  void AddTranslation(const ChordalEdge& edge) {
    const int i = stage_.BlockOf(edge.i), j = stage_.BlockOf(edge.j);
    if (i < 0 && j < 0) return;
    const int first = kSize == 3 ? 3 : 0;
    double frame[9], turned[9], half[9] = {}, weight[9] = {}, negative[9], measured[3] = {};
    RotationOf(kSize, records_.data() + int64_t{edge.i} * kRecord, frame);
    for (int r = 0; r < kSize; ++r) {
      for (int c = 0; c < kSize; ++c) {
        turned[r * kSize + c] = 0;
        for (int k = 0; k < kSize; ++k) {
          turned[r * kSize + c] += frame[r * kSize + k] * edge.rotation[k * kSize + c];
        }
        measured[r] += frame[r * kSize + c] * edge.translation[c];
      }
    }
    for (int r = 0; r < kSize; ++r) {
      for (int c = 0; c < kSize; ++c) {
        for (int k = 0; k < kSize; ++k) {
          half[r * kSize + c] +=
              turned[r * kSize + k] * edge.information[(first + k) * kTangent + first + c];
        }
      }
    }
    for (int r = 0; r < kSize; ++r) {
      for (int c = 0; c < kSize; ++c) {
        for (int k = 0; k < kSize; ++k)
          weight[r * kSize + c] += half[r * kSize + k] * turned[c * kSize + k];
        negative[r * kSize + c] = -weight[r * kSize + c];
      }
    }
    if (i >= 0) stage_.AddDiagonal(i, weight);
    if (j >= 0) stage_.AddDiagonal(j, weight);
    if (i >= 0 && j >= 0) stage_.AddPair(i, j, negative);
    const double* const t_i = TranslationOf(kSize, poses_.data() + int64_t{edge.i} * kAmbient);
    const double* const t_j = TranslationOf(kSize, poses_.data() + int64_t{edge.j} * kAmbient);
    for (int r = 0; r < kSize; ++r) {
      for (int c = 0; c < kSize; ++c) {
        const double w = weight[r * kSize + c];
        if (i >= 0) stage_.AddRhs(i, 0, r, w * ((j < 0 ? t_j[c] : 0) - measured[c]));
        if (j >= 0) stage_.AddRhs(j, 0, r, w * ((i < 0 ? t_i[c] : 0) + measured[c]));
      }
    }
  }

  const PoseGraph& graph_;
  const double* information_;
  const EdgePattern pattern_;
  ChordalStage<kSize> stage_;
  std::vector<double> poses_, records_;  ///< relative_pose.h
};

}  // namespace

std::vector<double> ChordalPoses(const PoseGraph& graph, const double* information, int num_threads,
                                 const FillOrdering* known) {
  return graph.dimension() == 2 ? Chordal<2>(graph, information, num_threads, known).Poses()
                                : Chordal<3>(graph, information, num_threads, known).Poses();
}

}  // namespace bundle
