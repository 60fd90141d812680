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
///
/// Functions of a type T take one edge, as doubles, or several (kernels/edge_lanes.cpp).

#include <cstdint>

#include "core/factors/loss.h"
#include "core/pose_graph/pose_graph.h"
#include "core/pose_graph/relative_pose.h"

namespace bundle {

/// m <- U m for kColumns columns, row-major, in place.
template <int kSize, int kColumns, typename T>
void ApplyRoot(const T* root, T* m) {
  for (int r = 0; r < kSize; ++r) {
    const T diagonal = *root++;
    T row[kColumns];
    for (int c = 0; c < kColumns; ++c) row[c] = diagonal * m[r * kColumns + c];
    for (int k = r + 1; k < kSize; ++k) {
      const T factor = *root++;
      for (int c = 0; c < kColumns; ++c) row[c] += factor * m[k * kColumns + c];
    }
    for (int c = 0; c < kColumns; ++c) m[r * kColumns + c] = row[c];
  }
}

template <typename Group>
const double* RootOf(const PoseGraph& graph, int64_t edge) {
  return graph.prepared->roots.data() + edge * RootSize(Group::kTangent);
}

/// The whitened residual; A and Ad are also computed unless `a` and `adjoint` are nullptr.
template <typename Group, typename T>
void EvaluateWhitened(PoseError error, const T* x_i, const T* x_j, const T* z, const T* root,
                      T* residual, T* a, T* adjoint) {
  EvaluateRelativePose<Group>(error, x_i, x_j, z, residual, a, adjoint);
  ApplyRoot<Group::kTangent, 1>(root, residual);
  if (a != nullptr) ApplyRoot<Group::kTangent, Group::kTangent>(root, a);
}

/// The same of an edge. `records`: those of the poses (relative_pose.h).
template <typename Group>
void EvaluateWhitened(const PoseGraph& graph, int64_t edge, const double* records, double* residual,
                      double* a = nullptr, double* adjoint = nullptr) {
  EvaluateWhitened<Group>(graph.errors.error,
                          records + int64_t{graph.edges()[2 * edge]} * Group::kRecord,
                          records + int64_t{graph.edges()[2 * edge + 1]} * Group::kRecord,
                          graph.prepared->records.data() + edge * Group::kRecord,
                          RootOf<Group>(graph, edge), residual, a, adjoint);
}

/// Places of an edge's contribution among kNumbers values. Of symmetric matrices the upper triangle
/// is stored, by rows.
template <typename Group>
struct EdgeTerms {
  static constexpr int kSize = Group::kTangent;
  static constexpr int kTriangle = kSize * (kSize + 1) / 2;
  static constexpr int kIi = 0, kJj = kTriangle;        ///< H_ii, H_jj
  static constexpr int kIj = 2 * kTriangle;             ///< H_ij, row-major
  static constexpr int kGi = kIj + kSize * kSize;       ///< g_i
  static constexpr int kGj = kGi + kSize;               ///< g_j
  static constexpr int kChi2 = kGj + kSize;             ///< ||r~||^2, without the loss
  static constexpr int kNumbers = (kChi2 + 4) / 4 * 4;  ///< a multiple of 4
};

/// The contribution of an edge, without the loss.
template <typename Group, typename T>
void LinearizeEdge(PoseError error, const T* x_i, const T* x_j, const T* z, const T* root,
                   T* terms) {
  using Terms = EdgeTerms<Group>;
  constexpr int kSize = Group::kTangent;
  T residual[kSize], a[kSize * kSize], adjoint[kSize * kSize], n[kSize * kSize];
  EvaluateWhitened<Group>(error, x_i, x_j, z, root, residual, a, adjoint);
  T chi2 = 0;
  for (int r = 0; r < kSize; ++r) chi2 += residual[r] * residual[r];
  terms[Terms::kChi2] = chi2;
  T* jj = terms + Terms::kJj;
  for (int r = 0; r < kSize; ++r) {
    T gradient = 0;
    for (int k = 0; k < kSize; ++k) gradient += a[k * kSize + r] * residual[k];
    terms[Terms::kGj + r] = gradient;
    for (int c = r; c < kSize; ++c) {
      T sum = 0;
      for (int k = 0; k < kSize; ++k) sum += a[k * kSize + r] * a[k * kSize + c];
      n[r * kSize + c] = n[c * kSize + r] = *jj++ = sum;
    }
  }
  T* ii = terms + Terms::kIi;
  for (int r = 0; r < kSize; ++r) {
    T half[kSize], gradient = 0;
    for (int c = 0; c < kSize; ++c) half[c] = 0;
    for (int k = 0; k < kSize; ++k) {
      const T factor = adjoint[k * kSize + r];
      gradient += factor * terms[Terms::kGj + k];
      for (int c = 0; c < kSize; ++c) half[c] += factor * n[k * kSize + c];
    }
    terms[Terms::kGi + r] = -gradient;
    for (int c = 0; c < kSize; ++c) terms[Terms::kIj + r * kSize + c] = -half[c];
    for (int c = r; c < kSize; ++c) {
      T sum = 0;
      for (int k = 0; k < kSize; ++k) sum += half[k] * adjoint[k * kSize + c];
      *ii++ = sum;
    }
  }
}

}  // namespace bundle
