#include "core/pose_graph/pose_graph.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>

#include "core/error.h"
#include "core/factors/factor.h"
#include "core/pose_graph/edge_kernel.h"
#include "core/pose_graph/kernels/edge_kernels.h"

namespace bundle {
namespace {

/// Tolerance for two entries that should be equal, relative to the diagonal's.
constexpr double kAsymmetry = 1e-9;

bool IsSymmetric(const double* matrix, int n) {
  for (int r = 0; r < n; ++r) {
    for (int c = 0; c <= r; ++c) {
      const double one = matrix[r * n + c], other = matrix[c * n + r];
      if (!std::isfinite(one) || !std::isfinite(other)) return false;
      const double scale =
          std::max({std::sqrt(std::abs(matrix[r * n + r] * matrix[c * n + c])), std::abs(one)});
      if (!(std::abs(one - other) <= kAsymmetry * scale)) return false;
    }
  }
  return true;
}

/// U with U^T U = A, its upper triangle by rows; false if A is not positive semidefinite. U_kk^2 is
/// the pivot: A_kk after subtracting earlier rows. A pivot at rounding level relative to A_kk is
/// set to 0, with its row: coordinates without information are allowed.
bool FindRoot(const double* matrix, int n, double* root) {
  double upper[36];
  for (int k = 0; k < n; ++k) {
    const double given = matrix[k * n + k];
    const double rounding = 8 * n * std::numeric_limits<double>::epsilon() * given;
    for (int c = k; c < n; ++c) {
      double rest = matrix[k * n + c];
      for (int i = 0; i < k; ++i) rest -= upper[i * n + k] * upper[i * n + c];
      if (c == k) {
        if (!(rest >= -rounding) || !std::isfinite(rest)) return false;
        upper[k * n + k] = rest > rounding ? std::sqrt(rest) : 0;
      } else if (upper[k * n + k] > 0) {
        upper[k * n + c] = rest / upper[k * n + k];
      } else {
        const double scale = std::sqrt(std::abs(given * matrix[c * n + c]));
        if (!(std::abs(rest) <= 1e-7 * scale)) return false;
        upper[k * n + c] = 0;
      }
      *root++ = upper[k * n + c];
    }
  }
  return true;
}

void CheckEnds(int64_t num_poses, int64_t num_edges, const int32_t* ends) {
  for (int64_t e = 0; e < num_edges; ++e) {
    const int32_t i = ends[2 * e], j = ends[2 * e + 1];
    const bool exist = i >= 0 && j >= 0 && i < num_poses && j < num_poses;
    if (exist && i != j) continue;
    throw InputError("edges[" + std::to_string(e) + "]: expected two different poses of the " +
                     std::to_string(num_poses) + ", found " + std::to_string(i) + " and " +
                     std::to_string(j));
  }
}

/// Normalises quaternions.
std::vector<double> Normalized(const Retraction& retraction, const char* name, int64_t count,
                               const double* values) {
  const int n = retraction.ambient_size();
  std::vector<double> result(values, values + count * n);
  for (int64_t i = 0; i < count; ++i) {
    double* const value = result.data() + i * n;
    const bool finite = std::all_of(value, value + n, [](double v) { return std::isfinite(v); });
    if (finite && retraction.Normalize(value)) continue;
    throw InputError(
        std::string(name) + "[" + std::to_string(i) + "]: expected " +
        (finite ? "a quaternion, found norm 0" : "finite numbers, found infinity or nan"));
  }
  return result;
}

}  // namespace

PoseGraphEdges PrepareEdges(int dimension, int64_t num_poses, int64_t num_edges,
                            const int32_t* ends, const double* measurements,
                            const double* information) {
  CheckEnds(num_poses, num_edges, ends);
  PoseGraphEdges edges;
  edges.dimension = dimension;
  edges.ends.assign(ends, ends + 2 * num_edges);
  edges.measurements = Normalized(RetractionOf(dimension), "measurements", num_edges, measurements);
  edges.records =
      dimension == 2 ? PoseRecords<Se2>(edges.measurements) : PoseRecords<Se3>(edges.measurements);
  const int tangent = TangentSize(dimension);
  const int64_t root_size = RootSize(tangent);
  edges.has_information = std::any_of(information, information + num_edges * tangent * tangent,
                                      [](double value) { return value != 0; });
  edges.roots.resize(num_edges * root_size);
  for (int64_t e = 0; e < num_edges; ++e) {
    const double* const matrix = information + e * tangent * tangent;
    const bool is_valid = IsSymmetric(matrix, tangent) &&
                          FindRoot(matrix, tangent, edges.roots.data() + e * root_size);
    if (!is_valid) edges.bad.push_back(e);
  }
  return edges;
}

RootExponents ExponentsOfRoots(const PoseGraphEdges& edges) {
  const int tangent = TangentSize(edges.dimension), rotations = edges.dimension == 2 ? 1 : 3;
  const int first_rotation = edges.dimension == 2 ? 2 : 0;
  int64_t sums[2] = {}, counts[2] = {};
  for (size_t begin = 0; begin < edges.roots.size(); begin += RootSize(tangent)) {
    for (int k = 0, at = 0; k < tangent; at += tangent - k, ++k) {
      const double entry = edges.roots[begin + at];
      if (!(entry > 0)) continue;
      const int kind = k >= first_rotation && k < first_rotation + rotations ? 0 : 1;
      sums[kind] += std::ilogb(entry);
      ++counts[kind];
    }
  }
  const auto mean = [&](int kind) {
    return static_cast<int>(
        std::floor(static_cast<double>(sums[kind]) / static_cast<double>(counts[kind])));
  };
  RootExponents found;
  if (counts[0] > 0) found.rotation = mean(0);
  if (counts[1] > 0) found.translation = mean(1);
  if (counts[0] == 0) found.rotation = found.translation;
  if (counts[1] == 0) found.translation = found.rotation;
  return found;
}

std::shared_ptr<const PoseGraphEdges> ScaledEdges(const PoseGraphEdges& edges, int exponent) {
  auto scaled = std::make_shared<PoseGraphEdges>(edges);
  const double factor = std::ldexp(1.0, exponent);
  for (double& entry : scaled->roots) entry *= factor;
  return scaled;
}

PoseGraph MakePoseGraph(const PoseGraphView& view, const PoseErrorOptions& errors) {
  PoseGraph graph;
  graph.errors = errors;
  graph.prepared = view.edges;
  graph.poses = Normalized(RetractionOf(view.dimension()), "poses", view.num_poses, view.poses);
  graph.held.assign(view.held, view.held + view.num_poses);
  if (view.robust != nullptr) graph.robust.assign(view.robust, view.robust + view.num_edges());
  return graph;
}

std::vector<int32_t> FindComponents(int64_t num_poses, int64_t num_edges, const int32_t* edges) {
  std::vector<int32_t> parent(num_poses);
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int32_t pose) {
    while (parent[pose] != pose) pose = parent[pose] = parent[parent[pose]];
    return pose;
  };
  for (int64_t e = 0; e < num_edges; ++e) {
    const int32_t a = root(edges[2 * e]), b = root(edges[2 * e + 1]);
    parent[std::max(a, b)] = std::min(a, b);
  }
  for (int64_t i = 0; i < num_poses; ++i) parent[i] = root(static_cast<int32_t>(i));
  return parent;
}

template <typename Group>
std::vector<double> PoseRecords(const std::vector<double>& poses) {
  const size_t count = poses.size() / Group::kAmbient;
  std::vector<double> records(count * Group::kRecord);
  SelectEdgeKernels<Group>().records(poses.data(), static_cast<int64_t>(count), records.data());
  return records;
}

template std::vector<double> PoseRecords<Se2>(const std::vector<double>&);
template std::vector<double> PoseRecords<Se3>(const std::vector<double>&);

template <typename Group>
std::vector<double> EdgeChi2AtRecords(const PoseGraph& graph, const std::vector<double>& records) {
  std::vector<int64_t> edges(graph.num_edges());
  std::iota(edges.begin(), edges.end(), int64_t{0});
  std::vector<double> chi2(edges.size());
  SelectEdgeKernels<Group>().chi2(graph.Arrays(records.data()), edges.data(), graph.num_edges(),
                                  chi2.data());
  return chi2;
}

template std::vector<double> EdgeChi2AtRecords<Se2>(const PoseGraph&, const std::vector<double>&);
template std::vector<double> EdgeChi2AtRecords<Se3>(const PoseGraph&, const std::vector<double>&);

std::vector<double> EdgeChi2(const PoseGraph& graph, const std::vector<double>& poses) {
  return graph.dimension() == 2 ? EdgeChi2AtRecords<Se2>(graph, PoseRecords<Se2>(poses))
                                : EdgeChi2AtRecords<Se3>(graph, PoseRecords<Se3>(poses));
}

namespace {

constexpr int64_t kEdgesAtATime = 128;

template <typename Group>
double CostUpToOf(const PoseGraph& graph, const std::vector<double>& poses, double limit) {
  std::vector<double> records(graph.num_poses() * Group::kRecord);
  std::vector<uint8_t> has_record(graph.num_poses(), 0);
  std::vector<int64_t> edges(graph.num_edges());
  std::iota(edges.begin(), edges.end(), int64_t{0});
  double cost = 0, chi2[kEdgesAtATime];
  for (int64_t begin = 0; begin < graph.num_edges() && cost <= limit; begin += kEdgesAtATime) {
    const int64_t count = std::min(kEdgesAtATime, graph.num_edges() - begin);
    for (int64_t k = 2 * begin; k < 2 * (begin + count); ++k) {
      const int64_t pose = graph.edges()[k];
      if (has_record[pose] != 0) continue;
      has_record[pose] = 1;
      Group::Record(&poses[pose * Group::kAmbient], &records[pose * Group::kRecord]);
    }
    SelectEdgeKernels<Group>().chi2(graph.Arrays(records.data()), edges.data() + begin, count,
                                    chi2);
    for (int64_t k = 0; k < count; ++k) cost += 0.5 * chi2[k];
  }
  return cost;
}

}  // namespace

double CostUpTo(const PoseGraph& graph, const std::vector<double>& poses, double limit) {
  return graph.dimension() == 2 ? CostUpToOf<Se2>(graph, poses, limit)
                                : CostUpToOf<Se3>(graph, poses, limit);
}

std::vector<double> EdgeWeights(const PoseGraph& graph, const std::vector<double>& chi2) {
  std::vector<double> weights(chi2.size());
  for (size_t e = 0; e < chi2.size(); ++e) {
    double rho[3];
    ValueOfEdgeLoss(graph.LossOf(static_cast<int64_t>(e)), graph.errors.loss_scale, chi2[e], rho);
    weights[e] = rho[1];
  }
  return weights;
}

}  // namespace bundle
