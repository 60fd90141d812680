#pragma once

/// A pose graph, validated and prepared for a solve: unit quaternions, square roots of information.

#include <cstdint>
#include <vector>

#include "core/geometry/retraction.h"
#include "core/pose_graph/edge_loss.h"
#include "core/pose_graph/relative_pose.h"

namespace bundle {

/// Arrays of the caller: world_from_body poses, x y angle or qx qy qz qw tx ty tz.
struct PoseGraphView {
  int dimension = 0;  ///< 2 or 3
  int64_t num_poses = 0;
  int64_t num_edges = 0;
  const double* poses = nullptr;         ///< num_poses x 3 or 7
  const uint8_t* held = nullptr;         ///< num_poses: 1 if a pose is constant
  const int32_t* edges = nullptr;        ///< num_edges x 2
  const double* measurements = nullptr;  ///< num_edges x 3 or 7
  /// num_edges x d (d + 1) / 2, as PoseGraph::roots; nullptr if errors are not evaluated.
  const double* roots = nullptr;
  const uint8_t* robust =
      nullptr;  ///< num_edges: 1 if the loss applies; nullptr: it applies to no edge

  int ambient() const { return dimension == 2 ? Se2::kAmbient : Se3::kAmbient; }
  int tangent() const { return dimension == 2 ? Se2::kTangent : Se3::kTangent; }
  Retraction retraction() const {
    return {dimension == 2 ? Manifold::kSe2 : Manifold::kSe3, ambient()};
  }
};

/// The error function of a graph, and its loss.
struct PoseErrorOptions {
  PoseError error = PoseError::kLog;
  EdgeLoss loss;
  double loss_scale = 1;  ///< in sigmas: of the whitened residual's norm
};

struct PoseGraph {
  int dimension = 0;
  PoseErrorOptions errors;
  std::vector<double> poses;
  std::vector<uint8_t> held;
  std::vector<int32_t> edges;
  std::vector<double> measurements;
  std::vector<double> measurement_records;  ///< relative_pose.h; empty if there are no roots
  /// num_edges x d (d + 1) / 2: the upper triangle of U with U^T U the information, by rows. Empty
  /// if the view has no information.
  std::vector<double> roots;
  std::vector<uint8_t> robust;  ///< num_edges

  int64_t num_poses() const { return static_cast<int64_t>(held.size()); }
  int64_t num_edges() const { return static_cast<int64_t>(robust.size()); }
  EdgeLoss LossOf(int64_t edge) const { return robust[edge] != 0 ? errors.loss : EdgeLoss(); }
};

/// Throws InputError if arrays contradict each other: an edge of a pose that does not exist or from
/// a pose to itself, a number that is not finite, or a quaternion of norm 0.
PoseGraph MakePoseGraph(const PoseGraphView& view, const PoseErrorOptions& errors);

/// Square roots of information matrices (PoseGraph::roots), d x d by tangent coordinates. `bad`
/// lists the edges whose matrix is asymmetric, not positive semidefinite or not finite.
struct InformationRoots {
  std::vector<double> roots;
  std::vector<int64_t> bad;
};
InformationRoots FindInformationRoots(int64_t num_edges, int tangent, const double* information);

/// Connected components: for each pose, the smallest position in its component.
std::vector<int32_t> FindComponents(int64_t num_poses, int64_t num_edges, const int32_t* edges);

/// r^T Omega r of each edge at `poses`, without the loss and without 1/2.
std::vector<double> EdgeChi2(const PoseGraph& graph, const std::vector<double>& poses);

/// Weight rho' of the loss on the information of each edge, with r^T Omega r as in EdgeChi2.
std::vector<double> EdgeWeights(const PoseGraph& graph, const std::vector<double>& chi2);

}  // namespace bundle
