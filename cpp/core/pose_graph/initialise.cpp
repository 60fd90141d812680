#include "core/pose_graph/initialise.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>

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

/// Sets the pose at the other end of an edge: X_j = X_i Z, or X_i = X_j Z^-1.
void Compose(const PoseGraph& graph, const Retraction& retraction, int64_t edge, int32_t from,
             std::vector<double>* poses) {
  const int n = retraction.ambient_size();
  const double* const z = graph.measurements().data() + edge * n;
  const bool forward = graph.edges()[2 * edge] == from;
  const int32_t to = graph.edges()[2 * edge + (forward ? 1 : 0)];
  const double* const x = poses->data() + int64_t{from} * n;
  double* const out = poses->data() + int64_t{to} * n;
  // X Z = (X^-1)^-1 Z and X Z^-1 = (Z X^-1)^-1, with the operations of a retraction.
  const double identity[7] = {0, 0, 0, graph.dimension() == 3 ? 1.0 : 0.0, 0, 0, 0};
  double inverse[7], moved[7];
  if (forward) {
    retraction.Between(x, identity, inverse);
    retraction.Between(inverse, z, moved);
  } else {
    retraction.Between(z, identity, inverse);
    double back[7];
    retraction.Between(x, identity, back);
    retraction.Between(back, inverse, moved);
  }
  retraction.Normalize(moved);
  std::copy(moved, moved + n, out);
}

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
  const Retraction retraction = RetractionOf(graph.dimension());
  std::vector<double> poses = graph.poses;
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
      Compose(graph, retraction, edge, from, &poses);
      queue.push_back(to);
    }
  }
  return poses;
}

namespace {

/// For each pair of poses with consecutive ids, in the order of ids: the lower pose, the upper
/// pose, and the first edge between them, or -1.
struct OdometryEdge {
  int32_t from, to;
  int64_t edge;
};

std::vector<OdometryEdge> FindOdometry(const PoseGraph& graph, const int64_t* ids) {
  std::vector<int32_t> order(graph.num_poses());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(),
                   [&](int32_t a, int32_t b) { return ids[a] < ids[b]; });
  std::vector<int32_t> rank(order.size());
  for (size_t k = 0; k < order.size(); ++k) rank[order[k]] = static_cast<int32_t>(k);
  std::vector<OdometryEdge> chain;
  for (size_t k = 1; k < order.size(); ++k) chain.push_back({order[k - 1], order[k], -1});
  for (int64_t e = 0; e < graph.num_edges(); ++e) {
    const int32_t a = rank[graph.edges()[2 * e]], b = rank[graph.edges()[2 * e + 1]];
    if (a - b != 1 && b - a != 1) continue;
    int64_t& edge = chain[std::min(a, b)].edge;
    if (edge < 0) edge = e;
  }
  return chain;
}

}  // namespace

std::pair<int32_t, int32_t> FindOdometryGap(const PoseGraph& graph, const int64_t* ids) {
  for (const OdometryEdge& link : FindOdometry(graph, ids)) {
    if (link.edge < 0) return {link.from, link.to};
  }
  return {-1, -1};
}

std::vector<double> OdometryPoses(const PoseGraph& graph, const int64_t* ids) {
  const std::vector<OdometryEdge> chain = FindOdometry(graph, ids);
  const Retraction retraction = RetractionOf(graph.dimension());
  std::vector<double> poses = graph.poses;
  std::vector<uint8_t> reached = graph.held;
  for (const OdometryEdge& link : chain) {
    if (link.edge < 0 || reached[link.from] == 0 || reached[link.to] != 0) continue;
    Compose(graph, retraction, link.edge, link.from, &poses);
    reached[link.to] = 1;
  }
  // Backwards from the first held pose, if it is not the first pose.
  for (auto link = chain.rbegin(); link != chain.rend(); ++link) {
    if (link->edge < 0 || reached[link->to] == 0 || reached[link->from] != 0) continue;
    Compose(graph, retraction, link->edge, link->to, &poses);
    reached[link->from] = 1;
  }
  return poses;
}

}  // namespace bundle
