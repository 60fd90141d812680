#pragma once

/// One edge of a pose graph: its whitened residual, and its contribution to the normal equations.
///
/// With U^T U the information, r~ = U r, A = U E and the adjoint Ad of relative_pose.h, the
/// whitened Jacobians are J_j = A and J_i = -A Ad. With N = A^T A and n = A^T r~ the edge adds
///
///   H_jj += N,      H_ij -= Ad^T N,      H_ii += Ad^T N Ad,      g_j += n,      g_i -= Ad^T n,
///
/// which takes three matrix products instead of five. A loss multiplies all terms by rho'
/// (factors/loss.h: no available loss has rho'' > 0).

#include <cstdint>

#include "core/factors/loss.h"
#include "core/pose_graph/pose_graph.h"
#include "core/pose_graph/relative_pose.h"

namespace bundle {

/// m <- U m for kColumns columns, row-major, in place.
template <int kSize, int kColumns>
void ApplyRoot(const double* root, double* m) {
  for (int r = 0; r < kSize; ++r) {
    const double diagonal = *root++;
    double row[kColumns];
    for (int c = 0; c < kColumns; ++c) row[c] = diagonal * m[r * kColumns + c];
    for (int k = r + 1; k < kSize; ++k) {
      const double factor = *root++;
      for (int c = 0; c < kColumns; ++c) row[c] += factor * m[k * kColumns + c];
    }
    for (int c = 0; c < kColumns; ++c) m[r * kColumns + c] = row[c];
  }
}

/// out = A^T B for kSize x kSize matrices, row-major.
template <int kSize>
void TransposedProduct(const double* a, const double* b, double* out) {
  for (int r = 0; r < kSize; ++r) {
    double row[kSize] = {};
    for (int k = 0; k < kSize; ++k) {
      const double factor = a[k * kSize + r];
      for (int c = 0; c < kSize; ++c) row[c] += factor * b[k * kSize + c];
    }
    for (int c = 0; c < kSize; ++c) out[r * kSize + c] = row[c];
  }
}

/// out = A^T v
template <int kSize>
void TransposedVector(const double* a, const double* v, double* out) {
  for (int c = 0; c < kSize; ++c) out[c] = 0;
  for (int r = 0; r < kSize; ++r) {
    for (int c = 0; c < kSize; ++c) out[c] += a[r * kSize + c] * v[r];
  }
}

template <typename Group>
const double* RootOf(const PoseGraph& graph, int64_t edge) {
  return graph.roots.data() + edge * (Group::kTangent * (Group::kTangent + 1) / 2);
}

/// The whitened residual; A and Ad are also computed unless `a` and `adjoint` are nullptr.
/// `records`: those of the poses (relative_pose.h).
template <typename Group>
void EvaluateWhitened(const PoseGraph& graph, int64_t edge, const double* records, double* residual,
                      double* a = nullptr, double* adjoint = nullptr) {
  EvaluateRelativePose<Group>(
      graph.errors.error, records + int64_t{graph.edges[2 * edge]} * Group::kRecord,
      records + int64_t{graph.edges[2 * edge + 1]} * Group::kRecord,
      graph.measurement_records.data() + edge * Group::kRecord, residual, a, adjoint);
  const double* const root = RootOf<Group>(graph, edge);
  ApplyRoot<Group::kTangent, 1>(root, residual);
  if (a != nullptr) ApplyRoot<Group::kTangent, Group::kTangent>(root, a);
}

/// Contributions of an edge; matrices row-major.
template <typename Group>
struct EdgeTerms {
  static constexpr int kSize = Group::kTangent;
  double cost;  ///< 1/2 rho(||r~||^2)
  double h_ii[kSize * kSize], h_ij[kSize * kSize], h_jj[kSize * kSize];
  double g_i[kSize], g_j[kSize];
};

template <typename Group>
void LinearizeEdge(const PoseGraph& graph, int64_t edge, const double* records,
                   EdgeTerms<Group>* terms) {
  constexpr int kSize = Group::kTangent;
  double residual[kSize], a[kSize * kSize], adjoint[kSize * kSize], half[kSize * kSize];
  EvaluateWhitened<Group>(graph, edge, records, residual, a, adjoint);
  double rho[3];
  ValueOfEdgeLoss(graph.LossOf(edge), graph.errors.loss_scale, SquaredNorm(residual, kSize), rho);
  terms->cost = 0.5 * rho[0];
  TransposedProduct<kSize>(a, a, terms->h_jj);
  TransposedVector<kSize>(a, residual, terms->g_j);
  if (rho[1] != 1) {
    for (double& value : terms->h_jj) value *= rho[1];
    for (double& value : terms->g_j) value *= rho[1];
  }
  TransposedProduct<kSize>(adjoint, terms->h_jj, half);
  TransposedVector<kSize>(adjoint, terms->g_j, terms->g_i);
  for (int r = 0; r < kSize; ++r) {
    terms->g_i[r] = -terms->g_i[r];
    for (int c = 0; c < kSize; ++c) {
      terms->h_ij[r * kSize + c] = -half[r * kSize + c];
      double sum = 0;
      for (int k = 0; k < kSize; ++k) sum += half[r * kSize + k] * adjoint[k * kSize + c];
      terms->h_ii[r * kSize + c] = sum;
    }
  }
}

}  // namespace bundle
