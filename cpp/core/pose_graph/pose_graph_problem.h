#pragma once

/// A pose graph as a LeastSquares (minimize/least_squares.h). Its normal equations are
/// block-sparse, with one block per free pose, factorised by linear/supernodal_cholesky.h.
///
/// Poses move by X Exp(d), with a new chart at each state. Held poses have no block; the cost of an
/// edge between two of them is constant.
///
/// With H = J^T J, g = J^T r and the Newton direction q of (H + l D^2) q = -g, products with H need
/// no second pass over J:
///
///   H q = -g - l D^2 q,    q^T H q = -g^T q - l q^T D^2 q,    p^T H q = -p^T g - l p^T D^2 q,
///
/// so the predicted decrease of a Newton step is -(g^T q + 1/2 q^T H q) = 1/2 (l q^T D^2 q - g^T
/// q), both terms of which are positive. Doglegs also need p^T H p, from a pass over the edges.
///
/// The linearisation processes some thousand edges at a time. Threads first evaluate them, each its
/// portion. Then each thread adds them up in its own block columns, in the order of the edges. No
/// bit depends on the number of threads.

#include <memory>
#include <string>
#include <vector>

#include "core/linear/fill_ordering.h"
#include "core/linear/linear_solver.h"
#include "core/minimize/least_squares.h"
#include "core/pose_graph/pose_graph.h"

namespace bundle {

class PoseGraphProblem : public LeastSquares {
 public:
  /// Poses at x, as the graph stores them.
  virtual const std::vector<double>& poses() const = 0;
  /// EdgeChi2 at x, without another pass over the poses.
  virtual std::vector<double> Chi2() const = 0;
  /// Sets x to poses in this form.
  virtual void Restore(const std::vector<double>& poses) = 0;
  /// Cost of edges between constant poses.
  virtual double fixed_cost() const = 0;
  virtual int num_free_poses() const = 0;
  virtual int64_t num_active_edges() const = 0;
  virtual const BlockStructure& structure() const = 0;
  /// The pose of each block of the structure.
  virtual const std::vector<int>& pose_of_blocks() const = 0;
  /// System of the last Linearize, with H plus damping and -g, and its solver.
  virtual BlockSystem& system() = 0;
  virtual LinearSolver& solver() = 0;
  virtual FactorStatistics factor_statistics() const = 0;
  /// Time for the pattern, the ordering and the structure of the factor.
  virtual double symbolic_time_in_seconds() const = 0;
};

/// Keeps a reference to the graph, which must have a free pose. `ordering`: "auto" for the
/// cheapest, "natural", "amd" or "metis". `known` as in PatternOfEdges.
std::unique_ptr<PoseGraphProblem> MakePoseGraphProblem(const PoseGraph& graph,
                                                       const std::string& ordering, int num_threads,
                                                       const FillOrdering* known = nullptr);

}  // namespace bundle
