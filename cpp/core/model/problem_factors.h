#pragma once

/// Factors other than the observations of a problem, as functions of a solver's unknowns.
///
/// A factor (factors/factor.h) is differentiated by the tangent coordinates of its variables. An
/// image is the variable cam_from_world on SE(3), T = (R, t), which moves to T Exp(phi, rho): to
/// first order R to R Exp(phi) and t to t + R rho. A solver's unknowns are the chart (w, t) of
/// factors/reprojection.h: R = Exp(v) R_a with v = w - w_a and the anchor (w_a, R_a). A step
/// (dw, dt) of these makes
///
///   R Exp(phi) = Exp(J_l(v) dw) R        =>   phi = R^T J_l(v) dw,
///   t + R rho  = t + dt                  =>   rho = R^T dt.
///
/// A scene that is solved about another origin c (model/scene_frame.h) has t' = t + R c for its
/// translations and X' = X - c for its points, but factors are in the user's world. As t = t' - R
/// c, and R c moves to R Exp(phi) c = R (c + phi x c),
///
///   t + R rho  = t' + dt - R (c + phi x c)   =>   rho = R^T dt + c x phi.
///
/// So a row (a, b) of a Jacobian w.r.t. (phi, rho) becomes, with b . (c x phi) = (b x c) . phi,
///
///   by w: (R (a + b x c))^T J_l(v),        by t: (R b)^T.
///
/// An image of a rig has no chart of its own. For the local coordinates of factors/rig_pose.h, J_l
/// is the identity here. M_f and M_s then map the row to rows by its frame and its sensor. Frames
/// and sensors are also variables, like images; a change of origin does not move a sensor.
///
/// Cameras, points, twists and readouts are Euclidean: their coordinates are the unknowns. A layout
/// keeps only the free columns of all of these (CameraBlock::columns).

#include <cstdint>
#include <memory>
#include <vector>

#include "core/factors/factor.h"
#include "core/interface/adjustment_problem.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"

namespace bundle {

/// A variable of a problem: an image's cam_from_world (qx qy qz qw tx ty tz, SE(3)), a camera's
/// parameters in COLMAP's order, a point's coordinates, a frame's rig_from_world or a sensor's
/// sensor_from_rig; the twist of an image or the readout of a camera with a rolling shutter.
struct ProblemVariable {
  enum class Kind { kImage, kCamera, kPoint, kFrame, kSensor, kTwist, kReadout };
  Kind kind = Kind::kImage;
  int index = 0;  ///< index in the problem's arrays
};

/// The numbers of a variable; the quaternion of a pose may have any norm.
const double* ValueOf(const ProblemVariable& variable, const AdjustmentProblem& problem);

struct ProblemFactors {
  std::vector<ProblemVariable> variables;  ///< Factor::blocks() are indices in it
  std::vector<std::unique_ptr<Factor>> factors;
};

/// The unknowns on which a factor depends.
struct FactorUnknowns {
  std::vector<int> points;  ///< free points, in the order of the factor
  std::vector<int> blocks;  ///< blocks of the layout, ascending
};

/// Unknowns of each factor of the problem; empty without factors.
std::vector<FactorUnknowns> FindFactorUnknowns(const AdjustmentProblem& problem,
                                               const ParameterLayout& layout);

/// True if the factor depends only on camera parameters, or on exactly one point and no other free
/// unknown. The elimination of the points then does not change the factor, or only adds to the
/// point's block.
inline bool LeavesPointsApart(const FactorUnknowns& unknowns) {
  return unknowns.points.empty() || (unknowns.points.size() == 1 && unknowns.blocks.empty());
}

/// True if a factor depends on variables other than cameras.
bool DependsOnPoses(const AdjustmentProblem& problem);
/// True if such a factor may fix the world. Ties of twists may not: of all motions of the world,
/// only a change of scale affects them, and they cannot determine it (factors/twist_tie.h).
bool MayFixGauge(const AdjustmentProblem& problem);

/// A factor as a function of a solver's unknowns. Several threads may evaluate it at the same time
/// if the factor allows it.
class ChartedFactor {
 public:
  /// Keeps references to the factor, the problem and the layout's blocks.
  ChartedFactor(const Factor& factor, const AdjustmentProblem& problem,
                const ParameterLayout& layout);

  const Factor& factor() const { return factor_; }
  const FactorUnknowns& unknowns() const { return unknowns_; }
  bool is_fixed() const { return num_columns_ == 0; }
  int num_residuals() const { return factor_.num_residuals(); }
  /// Columns of the Jacobian: three per free point, then those of the blocks.
  int num_columns() const { return num_columns_; }
  /// First column of each free point, then of each block, then the number of columns.
  const std::vector<int>& column_begin() const { return column_begin_; }

  /// The residual, without a loss, and unless it is nullptr the Jacobian, num_residuals x
  /// num_columns, row-major. `points`: one pointer per free point of the factor. False if there is
  /// no value or the residual is not finite.
  bool Evaluate(const CameraStates& cameras, const double* const* points, double* residual,
                double* jacobian) const;

  /// 1/2 rho(||r||^2); NaN if there is no value. `points` as for Evaluate.
  double Cost(const CameraStates& cameras, const double* const* points) const;

 private:
  struct Variable {
    ProblemVariable::Kind kind;
    int index;
    int free_point = -1;               ///< index in unknowns().points
    std::vector<int8_t> columns;       ///< free columns of the chart, or parameters
    std::vector<int> jacobian_column;  ///< destination of each of these columns
    std::vector<double> scale;         ///< factor of each of these columns
    /// Columns of an image's frame and sensor, 6 + 6, and their destinations.
    std::vector<int8_t> rig_columns;
    std::vector<int> rig_jacobian_column;

    bool is_free() const { return !columns.empty() || !rig_columns.empty(); }
  };

  const Factor& factor_;
  const AdjustmentProblem& problem_;
  FactorUnknowns unknowns_;
  std::vector<Variable> variables_;
  std::vector<int> column_begin_;
  int num_columns_ = 0;
};

}  // namespace bundle
