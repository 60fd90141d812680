#pragma once

/// The blocks of the normal equations that belong to one point, at the problem's own values:
///
///   V = sum J_p^T J_p    (3 x 3),        W_b = sum J_b^T J_p    (size of block b x 3),
///
/// over the point's observations, V also over factors of the point. Eliminating the point takes
/// W V^-1 W^T from the camera parameters' matrix.
///
/// With the second derivatives of the loss, beta g_p g_p^T and beta g_b g_p^T are added.
///
/// A point that its observations do not determine (one observation, rays without parallax) has
/// directions n with V n = 0, hence J_p n = 0 in every row and W n = 0: they do not couple with
/// other unknowns, and the exact elimination uses the pseudo-inverse of V. A direction is null if
/// its eigenvalue is below kNullPoint times the largest one. Null directions are dropped, never
/// damped.

#include <cstdint>
#include <memory>
#include <vector>

#include "core/covariance/observation_rows.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"

namespace bundle {

inline constexpr double kNullPoint = 1e-12;

/// g = J~^T r~ of an observation: by the unknowns of its block b, and by its point.
void ShareOf(const ObservationRows& rows, int b, double* share);
void PointShare(const ObservationRows& rows, double share[3]);

/// 3 x 3 and symmetric, so that rows are columns.
struct PointBlocks {
  double v[9];
  double inverse[9];         ///< V^-1 without null directions
  double null_projector[9];  ///< sum n n^T of the null directions
  double largest;            ///< eigenvalue of V, or about that
  int num_null = 0;          ///< null directions
  std::vector<int> blocks;   ///< blocks of the layout, ascending
  std::vector<int> begin;    ///< first row of each block's W in `w`
  std::vector<double> w;     ///< rows x 3, row-major
  std::vector<double> y;     ///< W V^-1, alike
};

/// Sums up points one after the other. One object a thread.
class PointAssembler {
 public:
  /// Observations by their point, and factors of one free point each, for all threads.
  struct Tracks {
    std::vector<int64_t> begin;        ///< num_points + 1
    std::vector<int64_t> observation;  ///< indices in the problem, in its order within a point
    std::vector<double> prior;         ///< J^T J of each point's factors, 9 each; empty: no factors
    std::vector<double> prior_gradient;  ///< and their J^T r, 3 each
  };
  static Tracks FindTracks(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const CameraStates& states);

  /// Keeps references to all.
  PointAssembler(const ParameterLayout& layout, const ObservationEvaluator& evaluator,
                 const Tracks& tracks, bool second_order = false);

  /// Assembles the blocks of a free point.
  void Assemble(int point, PointBlocks* blocks);

  /// The observations of the point that was assembled last, those that count.
  int num_rows() const { return num_rows_; }
  bool is_second_order() const { return second_order_; }
  const ObservationRows& row(int i) const { return rows_[i]; }

 private:
  void FindBlocks(PointBlocks* blocks);
  void AddSecondOrder(const ObservationRows& rows, PointBlocks* blocks) const;

  const ParameterLayout& layout_;
  const ObservationEvaluator& evaluator_;
  const Tracks& tracks_;
  const bool second_order_;
  std::vector<ObservationRows> rows_;  ///< the first num_rows_ of them
  int num_rows_ = 0;
  std::vector<int> place_;  ///< per block of the layout: place in PointBlocks::blocks
};

}  // namespace bundle
