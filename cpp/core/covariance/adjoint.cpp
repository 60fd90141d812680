#include "core/covariance/adjoint.h"

#include <algorithm>
#include <memory>

#include "core/covariance/adjoint_computation.h"

namespace bundle {
namespace {

SolveOptions WithoutGauge(const SolveOptions& options) {
  SolveOptions free = options;
  free.gauge = Gauge::kNone;
  return free;
}

CovarianceOptions OfAdjoint() {
  CovarianceOptions wanted;
  wanted.long_sums = false;
  return wanted;
}

}  // namespace

std::unique_ptr<AdjointSystem> AdjointSystem::Make(const AdjustmentProblem& problem,
                                                   const ProblemFactors* all,
                                                   const SolveOptions& options, bool exact) {
  return std::make_unique<AdjointComputation>(problem, all, options, exact);
}

AdjointComputation::AdjointComputation(const AdjustmentProblem& problem, const ProblemFactors* all,
                                       const SolveOptions& options, bool exact)
    : options_(WithoutGauge(options)),
      wanted_(OfAdjoint()),
      computation_(problem, options_, wanted_),
      all_(computation_.view()),
      ahead_(*this),
      behind_(*this) {
  all_.factors = all;
  if (all != nullptr) {
    for (const std::unique_ptr<Factor>& factor : all->factors) {
      factors_.emplace_back(*factor, all_, layout());
    }
  }
  computation_.HoldGauge();
  computation_.Factorize();
  is_exact_ = exact && FactorizeExactly();
}

/// By the maps of the images, of which those of unknowns on bounds are zero.
std::vector<uint8_t> AdjointComputation::Held() const {
  const int stride = all_.camera_params_stride;
  std::vector<uint8_t> held(size_t(all_.num_cameras) * stride, 1);
  for (int i = 0; i < all_.num_images; ++i) {
    uint8_t* const of_camera = &held[size_t(all_.image_camera[i]) * stride];
    for (const LocalMap& map : system().evaluator().maps(i)) {
      for (size_t c = 0; c < map.columns.size(); ++c) {
        const int parameter = map.columns[c] - kPoseSize;
        if (parameter < 0 || parameter >= stride || map.columns[c] >= kFirstTwist) continue;
        const double* const row = map.values.data() + c * map.size;
        const bool moves =
            map.values.empty() || std::any_of(row, row + map.size, [](double m) { return m != 0; });
        if (moves) of_camera[parameter] = 0;
      }
    }
  }
  return held;
}

void AdjointComputation::Directions(double* n, double* of_sums) const {
  const FreeGauge& gauge = *computation_.gauge_;
  for (int m = 0; m < degrees(); ++m) {
    for (double* const to : {n, of_sums}) {
      double* const column = to + m * size();
      std::fill_n(column, size(), 0.0);
      for (int j = 0; j < num_unknowns(); ++j) column[j] = gauge.cameras()(j, m);
      for (int p = 0; p < all_.num_points; ++p) {
        if (!layout().point_is_free(p)) continue;
        const FreeGauge::PointRows rows = to == n ? gauge.OfAnyPoint(p) : gauge.OfPoint(p);
        for (int k = 0; k < 3; ++k) column[num_unknowns() + 3 * int64_t{p} + k] = rows(k, m);
      }
    }
  }
}

std::vector<double> AdjointComputation::Gather(const InfluenceOptions& derivatives) const {
  const Eigen::MatrixXd cameras = computation_.GradientOfCameras(derivatives);
  std::vector<double> y(cameras.data(), cameras.data() + cameras.size());
  y.resize(size());
  for (int p = 0; p < all_.num_points; ++p) {
    if (!layout().point_is_free(p)) continue;
    std::copy_n(&derivatives.points[3 * size_t(p)], 3, &y[num_unknowns() + 3 * size_t(p)]);
  }
  return y;
}

void AdjointComputation::ClearHeld(double* gradient) const {
  const std::vector<uint8_t>& held = system().held();
  for (size_t j = 0; j < held.size(); ++j) {
    if (held[j] != 0) gradient[j] = 0;
  }
}

SolveOutput AdjointComputation::Moved(const double* step) {
  MoveTo(step, 1, &ahead_);
  const CameraStates& states = ahead_.evaluator.states();
  SolveOutput output;
  output.cam_from_world = states.CamFromWorld();
  output.rig_from_world = states.RigFromWorld();
  output.sensor_from_rig = states.SensorFromRig();
  output.camera_params = states.camera_params();
  output.twists = states.Twists();
  output.readouts = states.readouts();
  output.points = ahead_.points;
  computation_.centered_.MoveBack(&output);
  return output;
}

}  // namespace bundle
