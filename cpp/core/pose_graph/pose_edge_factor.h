#pragma once

/// An edge of a pose graph as a general factor (factors/factor.h), for the Ceres backend.

#include <cstdint>
#include <string>

#include "core/factors/factor.h"
#include "core/pose_graph/edge_kernel.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

template <typename Group>
class PoseEdgeFactor final : public Factor {
 public:
  /// Keeps a reference to the graph, whose loss must be one of factors. Its variables are the
  /// poses, by position.
  PoseEdgeFactor(const PoseGraph& graph, int64_t edge)
      : Factor({"edge " + std::to_string(edge),
                {graph.edges()[2 * edge], graph.edges()[2 * edge + 1]},
                graph.LossOf(edge).type,
                graph.errors.loss_scale},
               {Retraction(Group::kManifold, Group::kAmbient),
                Retraction(Group::kManifold, Group::kAmbient)},
               kSize),
        graph_(graph),
        edge_(edge) {}

  bool Evaluate(const double* const* values, double* residual,
                double* const* jacobians) const override {
    double a[kSize * kSize], adjoint[kSize * kSize];
    const bool wanted = jacobians != nullptr;
    double records[2][Group::kRecord];
    for (int k = 0; k < 2; ++k) Group::Record(values[k], records[k]);
    EvaluateWhitened<Group>(graph_.errors.error, records[0], records[1],
                            graph_.prepared->records.data() + edge_ * Group::kRecord,
                            RootOf<Group>(graph_, edge_), residual, wanted ? a : nullptr,
                            wanted ? adjoint : nullptr);
    if (!wanted) return true;
    for (int r = 0; r < kSize; ++r) {
      for (int c = 0; c < kSize; ++c) {
        if (jacobians[1] != nullptr) jacobians[1][r * kSize + c] = a[r * kSize + c];
        if (jacobians[0] == nullptr) continue;
        double sum = 0;
        for (int k = 0; k < kSize; ++k) sum -= a[r * kSize + k] * adjoint[k * kSize + c];
        jacobians[0][r * kSize + c] = sum;
      }
    }
    return true;
  }

 private:
  static constexpr int kSize = Group::kTangent;

  const PoseGraph& graph_;
  const int64_t edge_;
};

}  // namespace bundle
