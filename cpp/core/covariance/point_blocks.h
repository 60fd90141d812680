#pragma once

/// The blocks of one point in the normal equations, at the problem's own values:
///
///   V = sum J_p^T J_p    (3 x 3),        W_b = sum J_b^T J_p    (size of block b x 3),
///
/// over the point's observations; V also sums over factors of the point. Eliminating the point
/// subtracts W V^-1 W^T from the camera parameters' matrix.
///
/// If the observations of a point do not determine it (one observation, rays without parallax), it
/// has directions n with V n = 0. Hence J_p n = 0 in every row and W n = 0: these directions do not
/// couple with other unknowns, and the exact elimination uses the pseudo-inverse of V. A direction
/// is null if its eigenvalue is below kNullPoint times the largest one. Null directions are
/// dropped, never damped.

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

/// J~^T score of an observation, by the unknowns of its block b and by its point.
void ShareOf(const ObservationRows& rows, int b, double* share);
void PointShare(const ObservationRows& rows, double share[3]);

/// Row-major and column-major are the same here, because the matrices are symmetric.
struct PointBlocks {
  double v[9];
  double inverse[9];         ///< V^-1 without null directions
  double null_projector[9];  ///< sum n n^T of the null directions
  double largest;            ///< largest eigenvalue of V, approximately
  int num_null = 0;          ///< number of null directions
  std::vector<int> blocks;   ///< blocks of the layout, ascending
  std::vector<int> begin;    ///< first row of each block's W in `w`
  std::vector<double> w;     ///< rows x 3, row-major
  std::vector<double> y;     ///< W V^-1, in the same layout
};

/// Sums up the blocks of points, one after the other. Use one object per thread.
class PointAssembler {
 public:
  /// Observations by their point, and factors of one free point each; shared by all threads.
  struct Tracks {
    std::vector<int64_t> begin;        ///< num_points + 1
    std::vector<int64_t> observation;  ///< indices in the problem, in its order within a point
    std::vector<double>
        prior;  ///< J^T J of each point's factors, 9 numbers each; empty: no factors
    std::vector<double> prior_gradient;  ///< J^T r of these factors, 3 numbers each
  };
  static Tracks FindTracks(const AdjustmentProblem& problem, const ParameterLayout& layout,
                           const CameraStates& states);

  /// Keeps references to all arguments.
  PointAssembler(const ParameterLayout& layout, const ObservationEvaluator& evaluator,
                 const Tracks& tracks);

  /// Assembles the blocks of a free point.
  void Assemble(int point, PointBlocks* blocks);

  /// The observations that count of the point that was assembled last.
  int num_rows() const { return num_rows_; }
  const ObservationRows& row(int i) const { return rows_[i]; }

 private:
  void FindBlocks(PointBlocks* blocks);

  const ParameterLayout& layout_;
  const ObservationEvaluator& evaluator_;
  const Tracks& tracks_;
  std::vector<ObservationRows> rows_;  ///< the first num_rows_ are valid
  int num_rows_ = 0;
  std::vector<int> place_;  ///< per block of the layout: place in PointBlocks::blocks
};

}  // namespace bundle
