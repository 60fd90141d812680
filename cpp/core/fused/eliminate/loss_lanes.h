#pragma once

/// The robust losses, lane by lane; kernels_impl.h says how to include this.
///
/// rho(s) and rho'(s) at s = ||r||^2, as Ceres defines them (loss_function.h) with `scale` in
/// pixels. Every loss that a solve offers has rho'' <= 0, where Ceres leaves the second-order term
/// out (solve/triggs.h): what is left of Triggs' correction is the factor sqrt(rho') on r and J.

#include "core/fused/eliminate/pack.h"
#include "core/solve/options.h"

extern "C" double log(double) noexcept;
extern "C" double atan2(double, double) noexcept;

namespace bundle::fused::BUNDLE_ISA {

struct LossLanes {
  Pack rho;
  Pack weight;  ///< sqrt(rho')
};

inline LossLanes EvaluateLoss(LossType type, double scale, const Pack& s) {
  const Pack b = scale * scale;
  constexpr double kTiny = 2.2250738585072014e-308;  // as in Ceres: rho' never quite vanishes
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

}  // namespace bundle::fused::BUNDLE_ISA
