#pragma once

/// The gauge of a Newton direction.
///
/// If no factor fixes the world, its similarities change no residual: J N = 0, where the columns of
/// N are the derivatives of all free parameters w.r.t. the similarities. Multiplying the equation
/// of the Newton direction q, (J^T J + damping D^2) q = -J^T r, by N^T leaves
///
///   damping N^T D^2 q = -(J N)^T r = 0.
///
/// So q is orthogonal to N in the inner product of D^2. But S is rounded, and the solution divides
/// rounding errors along N by the damping. With the 1e-8 of doglegs, half of the digits of q depend
/// on the order of summation of S. The quadratic model does not depend on the component along N.
/// Costs at x + q do, because they are curved along N. The component along N is therefore removed:
///
///   q - N k,    (N^T D^2 N) k = N^T D^2 q,    <q,q> - k^T N^T D^2 q,
///
/// and the other products of a dogleg do not change, since <p,N> = r^T J N = 0. The rows of N for
/// cameras are those of model/gauge.h. For a point X about their centre c,
///
///   N_X = [I, -[X - c]_x, X - c],
///
/// a row of which has four nonzero numbers, so that sums over points consist of 4 x 4 blocks.
///
/// A world of rigs with sensors at different places has a fixed scale, and N has six columns.

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/model/camera_states.h"
#include "core/model/gauge.h"
#include "core/model/parameter_layout.h"
#include "core/schur/elimination_plan.h"
#include "core/scratch/large_vector.h"

namespace bundle {

class NewtonGauge {
 public:
  using Row = Eigen::Matrix<double, 1, kNumGaugeDirections>;
  using Square = Eigen::Matrix<double, kNumGaugeDirections, kNumGaugeDirections>;

  /// N^T D^2 N and N^T D^2 q.
  struct Sums {
    Square square = Square::Zero();
    Row product = Row::Zero();

    void Add(const Row& moves, double d_squared, double q);
    void Add(const Sums& other);
  };

  /// Number of columns of N: 7, 6 with rigs, 0 if a factor on any rank may fix the world.
  static int Degrees(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const EliminationPlan& plan);

  /// At a state of the cameras. Keeps a reference to the points, three numbers each.
  NewtonGauge(const AdjustmentProblem& problem, const ParameterLayout& layout, int degrees,
              const CameraStates& cameras, const LargeVector<double>& points);

  Row OfUnknown(size_t unknown) const;
  /// Adds points [first, last). Both arrays have 3 numbers for every point.
  void AddPoints(int first, int last, const LargeVector<double>& d_squared,
                 const LargeVector<double>& q, Sums* sums) const;
  /// N_X k of a point.
  Eigen::Vector3d MoveOfPoint(int point, const Row& k) const;

  /// k, from the sums over all unknowns and points; zero along null directions of N^T D^2 N.
  Row Solve(const Sums& sums) const;

 private:
  Eigen::Vector3d FromCentre(int point) const;

  const int degrees_;
  const Eigen::Vector3d centre_;
  const std::vector<double> unknowns_;  ///< unknowns x 7, row-major
  const LargeVector<double>& points_;
};

}  // namespace bundle
