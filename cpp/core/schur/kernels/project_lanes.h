#pragma once

/// The robust losses, lane by lane. Included by kernels.cpp only.
///
/// rho(s) and rho'(s) at s = ||r||^2, as Ceres defines them (loss_function.h) with `scale` in
/// pixels, or in sigmas where observations have them. Every loss that a solve offers has rho'' <=
/// 0, where Ceres omits the second-order term (factors/loss.h): Triggs' correction is then the
/// factor sqrt(rho') on r and J.

#include <type_traits>

#include "core/cameras/registry.h"
#include "core/factors/reprojection.h"
#include "core/interface/options.h"
#include "core/parallel/pack.h"

extern "C" double log(double) noexcept;
extern "C" double atan2(double, double) noexcept;

namespace bundle::BUNDLE_ISA {

struct LossLanes {
  Pack rho;
  Pack weight;  ///< sqrt(rho')
};

inline LossLanes EvaluateLoss(LossType type, double scale, const Pack& s) {
  const Pack b = scale * scale;
  constexpr double kTiny = 2.2250738585072014e-308;  // as in Ceres: rho' never becomes zero
  switch (type) {
    case LossType::kTrivial:
      break;
    case LossType::kHuber: {
      const Pack norm = Sqrt(s);
      const Mask inside = s <= b;
      return {Select(inside, s, 2 * scale * norm - b),
              Sqrt(Select(inside, 1.0, Max(kTiny, scale / norm)))};
    }
    case LossType::kSoftL1: {
      const Pack root = Sqrt(1 + s / b);
      return {2 * b * (root - 1), Sqrt(Max(kTiny, 1 / root))};
    }
    case LossType::kCauchy: {
      const Pack sum = 1 + s / b;
      Pack rho;
      for (int i = 0; i < kLanes; ++i) rho.v[i] = ::log(sum.v[i]);
      return {b * rho, Sqrt(Max(kTiny, 1 / sum))};
    }
    case LossType::kArctan: {
      Pack rho;
      for (int i = 0; i < kLanes; ++i) rho.v[i] = b.v[i] * ::atan2(s.v[i], b.v[i]);
      return {rho, Sqrt(Max(kTiny, 1 / (1 + s * s / (b * b))))};
    }
    case LossType::kTukey: {
      const Mask inside = s <= b;
      const Pack rest = 1 - s / b;
      return {b / 3 * Select(inside, 1 - rest * rest * rest, 1.0), Select(inside, rest, 0.0)};
    }
  }
  return {s, 1.0};
}

/// Camera models, several observations at once. Included by kernels.cpp only.
///
/// A perspective lens with a polynomial distortion has the same few operations for every point and
/// is computed in registers, by the formulae of its header. Other models branch by point or call
/// the mathematical library, and are computed lane by lane through their CameraModel.

/// Computes the residuals (2) of lanes [0, num_lanes), and unless nullptr their derivatives w.r.t.
/// the point in the camera (2x3) and the parameters (2 x their number). Later lanes may be
/// skipped, but hold numbers. Returns the lanes that count; outputs of all others are zero.
using ProjectLanes = void (*)(const CameraModel& model, const Pack* params, const Pack* point,
                              const Pack* measurement, Cheirality cheirality, Pack* residual,
                              Pack* d_point, Pack* d_params, Mask* counts, int num_lanes);

inline void ZeroUncounted(const Mask& counts, Pack* values, int size) {
  for (int i = 0; i < size; ++i) values[i] = Select(counts, values[i], 0.0);
}

/// cameras/perspective.h, in lanes.
struct PerspectiveLanes {
  Pack u, v, inverse_z;
  Mask counts;

  PerspectiveLanes(const Pack* point, Cheirality cheirality) {
    constexpr double kMinDepth = 2.220446049250313e-16;
    counts = point[2] >= kMinDepth;
    if (cheirality == Cheirality::kAlgebraic) counts = counts | (point[2] <= -kMinDepth);
    inverse_z = 1 / Select(counts, point[2], 1.0);
    u = point[0] * inverse_z;
    v = point[1] * inverse_z;
  }

  void ChainRow(const Pack& d_u, const Pack& d_v, Pack* d_point_row) const {
    d_point_row[0] = d_u * inverse_z;
    d_point_row[1] = d_v * inverse_z;
    d_point_row[2] = -(d_u * u + d_v * v) * inverse_z;
  }
};

template <typename Model>
void ProjectPerspective(const CameraModel&, const Pack* params, const Pack* point,
                        const Pack* measurement, Cheirality cheirality, Pack* residual,
                        Pack* d_point, Pack* d_params, Mask* counts, int) {
  using Distortion = typename Model::Distortion;
  const PerspectiveLanes rays(point, cheirality);
  Pack uv[2], d_uv[4], d_k[2 * Distortion::kNumParams + 1], xy[2];
  const bool derive = d_point != nullptr;
  Distortion::Distort(params + Model::kExtra, rays.u, rays.v, uv, derive ? d_uv : nullptr,
                      derive ? d_k : nullptr);
  Model::ToPixels(params, uv, xy);
  for (int row = 0; row < 2; ++row) residual[row] = xy[row] - measurement[row];
  if (derive) {
    Model::ChainPoint(params, rays, d_uv, d_point);
    Model::ChainParams(params, uv, d_k, d_params);
  }
  *counts = rays.counts;
  if (All(rays.counts)) return;
  ZeroUncounted(rays.counts, residual, 2);
  if (!derive) return;
  ZeroUncounted(rays.counts, d_point, 6);
  ZeroUncounted(rays.counts, d_params, 2 * Model::kNumLensParams);
}

inline void ProjectLaneByLane(const CameraModel& model, const Pack* params, const Pack* point,
                              const Pack* measurement, Cheirality cheirality, Pack* residual,
                              Pack* d_point, Pack* d_params, Mask* lanes_count, int num_lanes) {
  const int count = model.num_params;
  const bool derive = d_point != nullptr;
  if (num_lanes < kLanes) {
    for (int i = 0; i < 2; ++i) residual[i] = 0.0;
    for (int i = 0; i < 6 && derive; ++i) d_point[i] = 0.0;
    for (int i = 0; i < 2 * count && derive; ++i) d_params[i] = 0.0;
    for (int lane = num_lanes; lane < kLanes; ++lane) lanes_count->bits[lane] = -1;
  }
  for (int lane = 0; lane < num_lanes; ++lane) {
    double theta[kMaxCameraParams], p[3], xy[2], m[2], r[2] = {};
    double by_point[6] = {}, by_params[2 * kMaxCameraParams] = {};
    for (int i = 0; i < count; ++i) theta[i] = params[i].v[lane];
    for (int i = 0; i < 3; ++i) p[i] = point[i].v[lane];
    for (int i = 0; i < 2; ++i) m[i] = measurement[i].v[lane];
    const Projection projection =
        model.project(theta, p, xy, derive ? by_point : nullptr, derive ? by_params : nullptr);
    const bool counts = Counts(projection, cheirality);
    lanes_count->bits[lane] = counts ? -1 : 0;
    if (counts) model.difference(theta, xy, m, r, derive ? by_params : nullptr);
    for (int i = 0; i < 2; ++i) residual[i].v[lane] = r[i];
    if (!derive) continue;
    for (int i = 0; i < 6; ++i) d_point[i].v[lane] = counts ? by_point[i] : 0;
    for (int i = 0; i < 2 * count; ++i) d_params[i].v[lane] = counts ? by_params[i] : 0;
  }
}

template <typename Model, typename = void>
struct IsPolynomialPerspective : std::false_type {};
template <typename Model>
struct IsPolynomialPerspective<Model, std::void_t<typename Model::Rays>>
    : std::bool_constant<std::is_same_v<typename Model::Rays, Perspective> &&
                         Model::Distortion::kIsPolynomial> {};

template <typename Model>
constexpr ProjectLanes ChooseProjectLanes() {
  if constexpr (IsPolynomialPerspective<Model>::value) {
    return &ProjectPerspective<Model>;
  } else {
    return &ProjectLaneByLane;
  }
}

template <typename Models>
struct ProjectTable;
template <typename... Models>
struct ProjectTable<std::tuple<Models...>> {
  static constexpr ProjectLanes kOf[] = {ChooseProjectLanes<Models>()...};
};

/// One function per model in CameraModels.
inline constexpr const ProjectLanes* kProjectLanes = ProjectTable<CameraModels>::kOf;

}  // namespace bundle::BUNDLE_ISA
