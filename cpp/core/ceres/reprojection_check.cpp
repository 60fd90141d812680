#include "core/ceres/reprojection_check.h"

/// Checks the Jacobians of a solve's reprojection residuals, observation by observation.
///
/// The projection is singular at the camera's centre and, for some models, in the plane through it.
/// Let L be the distance of the point to the nearest singularity. Steps of the reference move the
/// point by less than L / 4 in its camera's frame, where central differences are a convergent power
/// series in step / L. The point's coordinates in that frame, R X + t, have the rounding error
///
///   delta = eps (|R X| + |t|),
///
/// so that every derivative w.r.t. pose and point has the relative error delta / L. If this is
/// large, as for points that an earlier solve left at a camera's centre, no comparison is possible.

#include <bundle/numeric_jacobian.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "core/ceres/gradient_check.h"
#include "core/ceres/reprojection_cost.h"
#include "core/model/camera_states.h"
#include "core/model/free_parameters.h"
#include "core/model/parameter_layout.h"
#include "core/parallel/thread_pool.h"
#include "core/problem/reprojection_errors.h"

namespace bundle {
namespace {

/// Makes a separate problem of one observation: one image, one camera, one point.
///
/// A solve's cost function reads camera parameters from CameraStates, which an EvaluationCallback
/// updates; GradientChecker has no callbacks. Here, the states belong to the cost function and
/// follow its parameters at each evaluation. So the check tests the same cost function as the
/// solve, including the packing of its columns.
class SingleObservation final : public ceres::CostFunction {
 public:
  SingleObservation(const AdjustmentProblem& problem, int64_t observation, const double* offset,
                    Cheirality cheirality)
      : problem_(Isolate(problem, observation, offset)),
        layout_(problem_, SelectFreeParameters(problem_, RefineAll())),
        states_(problem_, layout_),
        context_{problem_, layout_, states_, cheirality},
        cost_(MakeReprojectionCost(context_, 0)),
        state_(layout_.InitialState(problem_)) {
    std::copy_n(offset, 3, state_.begin());
    set_num_residuals(2);
    *mutable_parameter_block_sizes() = cost_->parameter_block_sizes();
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    states_.Update(parameters[1]);
    cost_->Evaluate(parameters, residuals, jacobians);
    const bool maybe_none = residuals[0] == 0 && residuals[1] == 0;
    return !maybe_none || HasValue(parameters[0]);
  }

  std::vector<const double*> start() const { return {problem_.points, state_.data()}; }
  const CameraBlock& block() const { return layout_.blocks()[0]; }

  /// True if the observation contributes under `cheirality` at its start.
  bool Counts(Cheirality cheirality) const {
    states_.Update(state_.data());
    return bundle::Counts(ProjectionOf(problem_.points), cheirality);
  }

  /// L and delta, and the motion of the point per unit of rotation.
  struct Surroundings {
    double distance = 0, rounding = 0, lever = 0;
  };

  Surroundings surroundings() const {
    states_.Update(state_.data());
    const PoseState& pose = states_.pose(0);
    double p[3], xy[2];
    MatrixVector3(pose.rotation, problem_.points, p);
    const double lever = Length(p);
    for (int i = 0; i < 3; ++i) p[i] += pose.translation[i];
    const double in_plane[3] = {p[0], p[1], 0};
    const bool plane = problem_.camera_models[0]->project(states_.params(0), in_plane, xy, nullptr,
                                                          nullptr) == Projection::kUndefined;
    const double distance = plane ? std::abs(p[2]) : Length(p);
    constexpr double kEpsilon = std::numeric_limits<double>::epsilon();
    return {distance, kEpsilon * (lever + Length(pose.translation)), lever};
  }

  /// Steps of each column: point, then the free camera parameters. Also the size of the pixels.
  KnownScales Scales() const {
    constexpr double kShare = 0.25;  // of the distance to the singularity
    constexpr double kAny = std::numeric_limits<double>::infinity();
    const Surroundings at = surroundings();
    const double reach = kShare * at.distance;
    std::vector<double> steps(3, reach);
    for (int k = 0; k < block().size; ++k) {
      const int column = block().columns[k];
      const double turn = at.lever > 0 ? reach / at.lever : kAny;
      const bool is_twist = column >= kFirstTwist;
      const int of_motion = is_twist ? column - kFirstTwist : column;
      steps.push_back(of_motion < 3           ? (is_twist ? std::min(turn, kShare) : turn)
                      : of_motion < kPoseSize ? reach
                                              : kAny);
    }
    double residual[2];
    const std::vector<const double*> at_start = start();
    Evaluate(at_start.data(), residual, nullptr);
    const double* measured = problem_.observation_xy;
    const double sigma = problem_.observation_sigma == nullptr ? 1 : *problem_.observation_sigma;
    const double minuend =
        std::hypot(residual[0], residual[1]) + std::hypot(measured[0], measured[1]) / sigma;
    return {steps, {minuend, minuend}};
  }

 private:
  static double Length(const double* v) { return std::hypot(v[0], v[1], v[2]); }

  static SolveOptions RefineAll() {
    SolveOptions options;
    options.refine_principal_point = true;
    return options;
  }

  AdjustmentProblem Isolate(const AdjustmentProblem& problem, int64_t observation,
                            const double* offset) {
    const int image = problem.observation_image[observation];
    const int camera = problem.image_camera[image];
    const int point = problem.observation_point[observation];
    const double* pose = problem.cam_from_world + 7 * static_cast<int64_t>(image);
    const double back[3] = {-offset[0], -offset[1], -offset[2]};
    double turn[4];
    ExpQuaternion(back, turn);
    QuaternionProduct(turn, pose, pose_);
    std::copy_n(pose + 4, 3, pose_ + 4);
    AdjustmentProblem one;
    one.num_images = one.num_cameras = one.num_points = 1;
    one.num_observations = 1;
    one.cam_from_world = pose_;
    one.image_ids = problem.image_ids + image;
    one.image_camera = &kFirst;
    one.camera_ids = problem.camera_ids + camera;
    one.camera_models = {problem.camera_models[camera]};
    one.camera_params = problem.ParamsOf(camera);
    one.camera_params_stride = problem.camera_params_stride;
    one.points = problem.points + 3 * static_cast<int64_t>(point);
    one.point_ids = problem.point_ids + point;
    one.observation_image = one.observation_point = &kFirst;
    one.observation_xy = problem.observation_xy + 2 * observation;
    if (!problem.row_scale.empty()) {
      one.row_scale.assign(problem.RowScaleOf(image), problem.RowScaleOf(image) + 2);
      one.twists = problem.TwistOf(image);
      one.readouts = problem.readouts + camera;
      one.at_observed_row = problem.at_observed_row;
    }
    if (problem.observation_sigma != nullptr) {
      one.observation_sigma = problem.observation_sigma + observation;
    }
    return one;
  }

  Projection ProjectionOf(const double* point) const {
    const PoseState& pose = states_.pose(0);
    double camera_point[3], xy[2];
    MatrixVector3(pose.rotation, point, camera_point);
    for (int i = 0; i < 3; ++i) camera_point[i] += pose.translation[i];
    if (const ImageShutter* const shutter = states_.shutter(0)) {
      return ResidualByRow(*problem_.camera_models[0], states_.params(0), *shutter, camera_point,
                           problem_.observation_xy, xy);
    }
    return problem_.camera_models[0]->project(states_.params(0), camera_point, xy, nullptr,
                                              nullptr);
  }

  /// False if the residual is zero because it cannot be computed: no differences are taken there.
  /// Called only for zero residuals, because it projects once more.
  bool HasValue(const double* point) const {
    return bundle::Counts(ProjectionOf(point), context_.cheirality);
  }

  static constexpr int32_t kFirst = 0;
  double pose_[7];
  AdjustmentProblem problem_;
  ParameterLayout layout_;
  mutable CameraStates states_;
  ReprojectionContext context_;
  std::unique_ptr<ceres::CostFunction> cost_;
  std::vector<double> state_;
};

/// Moves Jacobians from the blocks of the cost function (point, then the free camera parameters) to
/// the columns of ReprojectionCheck.
class Columns {
 public:
  Columns(const CameraBlock& block, const ProblemView& problem)
      : block_(block),
        first_twist_(kPoseSize + problem.camera_params_stride),
        size_(NumCheckedColumns(problem)),
        sources_(3 + block.size) {}

  int size() const { return size_; }

  /// Copies from a 2 x (3 + block.size) matrix.
  void Scatter(const double* from, double* to) const {
    for (int row = 0; row < 2; ++row, from += sources_, to += size_) {
      std::copy_n(from, 3, to + size_ - 3);
      for (int k = 0; k < block_.size; ++k) {
        const int column = block_.columns[k];
        to[column < kFirstTwist ? column : first_twist_ + column - kFirstTwist] = from[3 + k];
      }
    }
  }

 private:
  const CameraBlock& block_;
  const int first_twist_, size_, sources_;
};

/// Evaluates with Jacobians, concatenated as in NumericJacobian. True if the residual equals that
/// of an evaluation without Jacobians.
bool EvaluateJacobian(const SingleObservation& cost, std::vector<double>* jacobian) {
  const int size = cost.block().size;
  const std::vector<const double*> start = cost.start();
  std::vector<double> d_point(6), d_camera(2 * static_cast<size_t>(size));
  double* blocks[] = {d_point.data(), d_camera.data()};
  double with[2], without[2];
  cost.Evaluate(start.data(), with, blocks);
  cost.Evaluate(start.data(), without, nullptr);
  jacobian->clear();
  for (int row = 0; row < 2; ++row) {
    jacobian->insert(jacobian->end(), d_point.begin() + 3 * row, d_point.begin() + 3 * row + 3);
    jacobian->insert(jacobian->end(), d_camera.begin() + size * row,
                     d_camera.begin() + size * (row + 1));
  }
  return with[0] == without[0] && with[1] == without[1];
}

}  // namespace

void CheckReprojections(const AdjustmentProblem& problem, const int64_t* observations,
                        int64_t num_checked, const double* offsets, Cheirality cheirality,
                        double relative_precision, int num_threads, const ReprojectionCheck& out) {
  CheckCameraModelsKnown(problem);
  const int64_t entries = 2 * int64_t{NumCheckedColumns(problem)};
  const Manifolds flat(2, nullptr);
  const auto check = [&](int64_t i) {
    // Differences use the formula on both sides of the camera.
    const SingleObservation cost(problem, observations[i], offsets + 3 * i, Cheirality::kAlgebraic);
    for (double* matrix : {out.analytic, out.reference, out.uncertainty, out.ceres}) {
      std::fill_n(matrix + entries * i, entries, 0.0);
    }
    out.counts[i] = cost.Counts(cheirality) ? 1 : 0;
    out.agrees[i] = out.stable[i] = 1;
    const SingleObservation::Surroundings at = cost.surroundings();
    out.rounding[i] = at.rounding / at.distance;
    if (out.counts[i] == 0) return;
    const Columns columns(cost.block(), problem);
    std::vector<double> analytic;
    out.stable[i] = EvaluateJacobian(cost, &analytic) ? 1 : 0;
    columns.Scatter(analytic.data(), out.analytic + entries * i);
    const NumericJacobian reference =
        DifferentiateByRichardson(cost, flat, cost.start(), cost.Scales()).ambient;
    columns.Scatter(reference.values.data(), out.reference + entries * i);
    columns.Scatter(reference.uncertainty.data(), out.uncertainty + entries * i);
    const GradientCheckerProbe probe =
        RunGradientChecker(cost, flat, cost.start(), relative_precision);
    out.agrees[i] = probe.agrees ? 1 : 0;
    if (probe.local_numeric_jacobian.empty()) {
      std::fill_n(out.ceres + entries * i, entries, std::numeric_limits<double>::quiet_NaN());
    } else {
      columns.Scatter(probe.local_numeric_jacobian.data(), out.ceres + entries * i);
    }
  };
  constexpr int64_t kWorthAThread = 50;
  ParallelFor(
      num_checked, num_threads,
      [&](int64_t begin, int64_t end) {
        for (int64_t i = begin; i < end; ++i) check(i);
      },
      kWorthAThread);
}

}  // namespace bundle
