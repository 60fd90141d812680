#include "core/pose_graph/initialise.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <utility>

#include "core/pose_graph/closures.h"

namespace bundle {
namespace {

/// Edges at each pose.
struct Adjacency {
  std::vector<int64_t> begin;
  std::vector<int64_t> edge;
};

Adjacency EdgesAtPoses(const PoseGraph& graph) {
  Adjacency at;
  at.begin.assign(graph.num_poses() + 1, 0);
  for (const int32_t pose : graph.edges()) ++at.begin[pose + 1];
  std::partial_sum(at.begin.begin(), at.begin.end(), at.begin.begin());
  at.edge.resize(graph.edges().size());
  std::vector<int64_t> next(at.begin.begin(), at.begin.end() - 1);
  for (size_t k = 0; k < graph.edges().size(); ++k) {
    at.edge[next[graph.edges()[k]]++] = static_cast<int64_t>(k / 2);
  }
  return at;
}

/// Composes poses along edges. Rotations of the plane are composed as cosine and sine, and the
/// angle as a sum: no pose needs trigonometric functions but the held ones.
class Composer {
 public:
  explicit Composer(const PoseGraph& graph) : graph_(graph), poses_(graph.poses) {
    if (graph.dimension() == 3) return;
    turns_.resize(2 * graph.num_poses());
    for (int64_t i = 0; i < graph.num_poses(); ++i) {
      if (graph.held[i] == 0) continue;
      turns_[2 * i] = std::cos(poses_[3 * i + 2]);
      turns_[2 * i + 1] = std::sin(poses_[3 * i + 2]);
    }
  }

  /// Sets the pose at the other end of an edge: X_j = X_i Z, or X_i = X_j Z^-1.
  void Follow(int64_t edge, int32_t from) {
    const bool forward = graph_.edges()[2 * edge] == from;
    const int32_t to = graph_.edges()[2 * edge + (forward ? 1 : 0)];
    if (graph_.dimension() == 2) return MovePlanar(edge, from, to, forward);
    const double* const z = graph_.measurements().data() + edge * Se3::kAmbient;
    const double* const x = poses_.data() + int64_t{from} * Se3::kAmbient;
    double* const out = poses_.data() + int64_t{to} * Se3::kAmbient;
    // X Z = (X^-1)^-1 Z and X Z^-1 = (Z X^-1)^-1
    const double identity[7] = {0, 0, 0, 1, 0, 0, 0};
    double back[7], inverse[7];
    RigidMotionBetween(x, identity, back);
    if (forward) {
      RigidMotionBetween(back, z, out);
    } else {
      RigidMotionBetween(z, identity, inverse);
      RigidMotionBetween(back, inverse, out);
    }
    retraction_.Normalize(out);
  }

  std::vector<double> Poses() { return std::move(poses_); }

 private:
  /// X Z = (t_x + R_x t_z, R_x R_z) and X Z^-1 = (t_x - R_x R_z^T t_z, R_x R_z^T).
  void MovePlanar(int64_t edge, int32_t from, int32_t to, bool forward) {
    const double* const z = graph_.prepared->records.data() + edge * Se2::kRecord;
    const double* const x = poses_.data() + int64_t{from} * Se2::kAmbient;
    double* const out = poses_.data() + int64_t{to} * Se2::kAmbient;
    const double c = turns_[2 * int64_t{from}], s = turns_[2 * int64_t{from} + 1];
    const double sign = forward ? 1 : -1;
    const double new_c = c * z[3] - sign * s * z[4], new_s = s * z[3] + sign * c * z[4];
    const double frame_c = forward ? c : new_c, frame_s = forward ? s : new_s;
    const double moved[3] = {x[0] + sign * (frame_c * z[0] - frame_s * z[1]),
                             x[1] + sign * (frame_s * z[0] + frame_c * z[1]), x[2] + sign * z[2]};
    std::copy(moved, moved + 3, out);
    turns_[2 * int64_t{to}] = new_c, turns_[2 * int64_t{to} + 1] = new_s;
  }

  const PoseGraph& graph_;
  const Retraction retraction_ = RetractionOf(3);
  std::vector<double> poses_;
  std::vector<double> turns_;  ///< in 2D: cosine and sine per placed pose
};

}  // namespace

HeldPoses HoldPoses(int64_t num_poses, int64_t num_edges, const int32_t* edges,
                    const uint8_t* fixed) {
  HeldPoses result;
  result.held.assign(fixed, fixed + num_poses);
  const std::vector<int32_t> component = FindComponents(num_poses, num_edges, edges);
  std::vector<uint8_t> has_fixed(num_poses, 0);
  for (int64_t i = 0; i < num_poses; ++i) has_fixed[component[i]] |= fixed[i];
  for (int64_t i = 0; i < num_poses; ++i) {
    if (component[i] != i) continue;
    ++result.num_components;
    if (has_fixed[i] != 0) continue;
    result.held[i] = 1;
    result.for_gauge.push_back(static_cast<int32_t>(i));
  }
  return result;
}

std::vector<double> SpanningTreePoses(const PoseGraph& graph) {
  const Adjacency at = EdgesAtPoses(graph);
  Composer composer(graph);
  std::vector<uint8_t> reached = graph.held;
  std::vector<int32_t> queue;
  for (int64_t i = 0; i < graph.num_poses(); ++i) {
    if (reached[i] != 0) queue.push_back(static_cast<int32_t>(i));
  }
  for (size_t k = 0; k < queue.size(); ++k) {
    const int32_t from = queue[k];
    for (int64_t a = at.begin[from]; a < at.begin[from + 1]; ++a) {
      const int64_t edge = at.edge[a];
      const int32_t to =
          graph.edges()[2 * edge] == from ? graph.edges()[2 * edge + 1] : graph.edges()[2 * edge];
      if (reached[to] != 0) continue;
      reached[to] = 1;
      composer.Follow(edge, from);
      queue.push_back(to);
    }
  }
  return composer.Poses();
}

Odometry::Odometry(const PoseGraph& graph, const int64_t* ids) : graph_(graph) {
  const IdOrder order = OrderOfIds(graph.num_poses(), ids);
  chain_.reserve(order.pose.size());
  for (size_t k = 1; k < order.pose.size(); ++k) {
    chain_.push_back({order.pose[k - 1], order.pose[k], -1});
  }
  for (int64_t e = 0; e < graph.num_edges(); ++e) {
    const int32_t a = graph.edges()[2 * e], b = graph.edges()[2 * e + 1];
    if (IsClosure(order, ids, a, b)) continue;
    int64_t& edge = chain_[std::min(order.rank[a], order.rank[b])].edge;
    if (edge < 0) edge = e;
  }
}

std::pair<int32_t, int32_t> Odometry::Gap() const {
  for (const Link& link : chain_) {
    if (link.edge < 0) return {link.from, link.to};
  }
  return {-1, -1};
}

std::vector<double> Odometry::Poses() const {
  Composer composer(graph_);
  std::vector<uint8_t> reached = graph_.held;
  for (const Link& link : chain_) {
    if (link.edge < 0 || reached[link.from] == 0 || reached[link.to] != 0) continue;
    composer.Follow(link.edge, link.from);
    reached[link.to] = 1;
  }
  // Backwards from the first held pose, if it is not the first pose.
  for (auto link = chain_.rbegin(); link != chain_.rend(); ++link) {
    if (link->edge < 0 || reached[link->to] == 0 || reached[link->from] != 0) continue;
    composer.Follow(link->edge, link->to);
    reached[link->from] = 1;
  }
  return composer.Poses();
}

}  // namespace bundle
