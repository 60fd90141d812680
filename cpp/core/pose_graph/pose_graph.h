#pragma once

/// A pose graph, validated and prepared for a solve: unit quaternions, square roots of information.

#include <cstdint>
#include <memory>
#include <vector>

#include "core/geometry/retraction.h"
#include "core/pose_graph/edge_loss.h"
#include "core/pose_graph/kernels/edge_kernels.h"
#include "core/pose_graph/relative_pose.h"

namespace bundle {

/// Shape of a pose in 2D or 3D.
inline int AmbientSize(int dimension) { return dimension == 2 ? Se2::kAmbient : Se3::kAmbient; }
inline int TangentSize(int dimension) { return dimension == 2 ? Se2::kTangent : Se3::kTangent; }
inline Retraction RetractionOf(int dimension) {
  return {dimension == 2 ? Manifold::kSe2 : Manifold::kSe3, AmbientSize(dimension)};
}

/// Numbers of a root in PoseGraphEdges: a triangle, then zeros up to a multiple of 4.
constexpr int RootSize(int tangent) { return (tangent * (tangent + 1) / 2 + 3) / 4 * 4; }

/// The edges of a graph, prepared for any number of solves and evaluations at any poses.
struct PoseGraphEdges {
  int dimension = 0;                 ///< 2 or 3
  std::vector<int32_t> ends;         ///< num_edges x 2 poses
  std::vector<double> measurements;  ///< num_edges x 3 or 7, with unit quaternions
  std::vector<double> records;       ///< records of the measurements (relative_pose.h)
  /// num_edges x RootSize(d): the upper triangle of U with U^T U the information, by rows.
  std::vector<double> roots;
  /// Edges whose information is asymmetric, not positive semidefinite or not finite. They have no
  /// root, so that no error can be evaluated.
  std::vector<int64_t> bad;
  bool has_information = false;  ///< any edge has information other than 0
};

/// `ends`, `measurements`, `information`: num_edges x 2, x 3 or 7, x d x d.
///
/// Throws InputError if arrays contradict each other: an edge of a pose that does not exist or from
/// a pose to itself, a measurement that is not finite, or a quaternion of norm 0.
PoseGraphEdges PrepareEdges(int dimension, int64_t num_poses, int64_t num_edges,
                            const int32_t* ends, const double* measurements,
                            const double* information);

/// Typical sizes of the diagonal entries of roots, 2^rotation and 2^translation: geometric means
/// over the entries other than 0.
struct RootExponents {
  int rotation = 0, translation = 0;
};
RootExponents ExponentsOfRoots(const PoseGraphEdges& edges);

/// Edges with all roots multiplied by 2^exponent, which is exact.
std::shared_ptr<const PoseGraphEdges> ScaledEdges(const PoseGraphEdges& edges, int exponent);

/// Arrays of the caller: world_from_body poses, x y angle or qx qy qz qw tx ty tz.
struct PoseGraphView {
  int64_t num_poses = 0;
  const double* poses = nullptr;                ///< num_poses x 3 or 7
  const uint8_t* held = nullptr;                ///< num_poses: 1 if a pose is constant
  std::shared_ptr<const PoseGraphEdges> edges;  ///< edges of as many poses
  const uint8_t* robust =
      nullptr;  ///< num_edges: 1 if the loss applies; nullptr: it applies to no edge

  int dimension() const { return edges->dimension; }
  int64_t num_edges() const { return static_cast<int64_t>(edges->ends.size() / 2); }
  int ambient() const { return AmbientSize(dimension()); }
  int tangent() const { return TangentSize(dimension()); }
};

/// The error function of a graph, and its loss.
struct PoseErrorOptions {
  PoseError error = PoseError::kLog;
  EdgeLoss loss;
  double loss_scale = 1;  ///< in sigmas: of the whitened residual's norm
};

struct PoseGraph {
  PoseErrorOptions errors;
  std::vector<double> poses;
  std::vector<uint8_t> held;
  std::vector<uint8_t> robust;  ///< num_edges, or empty: the loss applies to no edge
  std::shared_ptr<const PoseGraphEdges> prepared;

  int dimension() const { return prepared->dimension; }
  const std::vector<int32_t>& edges() const { return prepared->ends; }
  const std::vector<double>& measurements() const { return prepared->measurements; }
  int64_t num_poses() const { return static_cast<int64_t>(held.size()); }
  int64_t num_edges() const { return static_cast<int64_t>(prepared->ends.size() / 2); }
  /// Arrays of a pass at poses with these records.
  EdgeArrays Arrays(const double* records) const {
    return {errors.error, prepared->ends.data(), records, prepared->records.data(),
            prepared->roots.data()};
  }
  EdgeLoss LossOf(int64_t edge) const {
    return !robust.empty() && robust[edge] != 0 ? errors.loss : EdgeLoss();
  }
};

/// Throws InputError if a pose is not finite or has a quaternion of norm 0.
PoseGraph MakePoseGraph(const PoseGraphView& view, const PoseErrorOptions& errors);

/// Connected components: for each pose, the smallest position in its component.
std::vector<int32_t> FindComponents(int64_t num_poses, int64_t num_edges, const int32_t* edges);

/// r^T Omega r of each edge at `poses`, without the loss and without 1/2.
std::vector<double> EdgeChi2(const PoseGraph& graph, const std::vector<double>& poses);

/// The records of poses (relative_pose.h).
template <typename Group>
std::vector<double> PoseRecords(const std::vector<double>& poses);

/// r^T Omega r of each edge from the records of the poses.
template <typename Group>
std::vector<double> EdgeChi2AtRecords(const PoseGraph& graph, const std::vector<double>& records);

/// 1/2 r^T Omega r of all edges, without the loss. Stops at the first sum above `limit` and returns
/// it: most starts of a graph exceed the cost of a solution after a few edges.
double CostUpTo(const PoseGraph& graph, const std::vector<double>& poses, double limit);

/// Weight rho' of the loss on the information of each edge, with r^T Omega r as in EdgeChi2.
std::vector<double> EdgeWeights(const PoseGraph& graph, const std::vector<double>& chi2);

}  // namespace bundle
