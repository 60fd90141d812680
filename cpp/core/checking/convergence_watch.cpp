#include "core/checking/convergence_watch.h"

/// The signature of a wrong Jacobian in the iterations of a solve.
///
/// A wrong Jacobian rarely crashes: the cost still decreases, only less than predicted. A trust
/// region method with true derivatives has two properties that it loses with wrong derivatives.
/// Both can be tested on the iterations alone. Notation: f the cost, g its gradient J^T r, G = J^T
/// J, H the true Hessian of f, d a step, p = -g^T d - 1/2 d^T G d > 0 the decrease that the model
/// predicts, q = (actual decrease) / p Ceres' relative_decrease, R the trust region radius, m = D /
/// (R G) the damping of a direction.
///
/// 1. Shorter steps make the model right. To second order
///
///      (1 - q) p = 1/2 d^T (H - G) d,
///
///    which vanishes faster than p. If R is so small that p is proportional to R (d follows the
///    scaled gradient), 1 - q is proportional to R, too, for any problem. If J^T r is not the
///    gradient of f, q tends to (true slope) / (predicted slope) along d instead, often a value
///    below zero. The test searches for a *ladder*: successive steps (rungs), each with a smaller R
///    and p, over which 1 - q does not change. Rejected steps all start from one point; for these,
///    p must fall by a factor of 32. For accepted steps, p must fall by a factor of 100 over six
///    rungs, at one gradient. With true derivatives, 1 - q can also stay large for a while, in two
///    cases that are not reported. If the cost jumps or saturates (a point passes behind its
///    camera; Tukey's loss), the actual change does not shrink with p, so that |q| grows. And
///    undamped steps do not shrink. Outliers, bad starts and valleys make R oscillate; there, q
///    recovers as R falls.
///
/// 2. The rate of linear convergence at the end can be measured in two ways. Along the slowest
///    direction, an error e becomes l e. True derivatives give a step of -H e / (G (1 + m)), hence
///
///      l = 1 - H / (G (1 + m)),     q = (1 + l) (1 + m) / (1 + 2 m),   in [(1 + l) / 2, 1 + l],
///
///    with l of either sign. Slow progress has q near 2 (robust losses, where G exceeds H), q near
///    0 (steps that overshoot) or, with damping, q = 1. Decreases fall by l^2 per step, which gives
///    |l|. True derivatives exclude every q between 1 - |l| and (1 + |l|) / 2. With m = 0, they
///    exclude every q between 1 - |l| and 1 + |l|; m is 0 if R changed and l did not. A Jacobian
///    column that is c times too large makes steps 1 / c as long, with the predicted decrease of
///    full steps: l = 1 - 1 / c and q = 1 - l^2 (1/2 and 3/4 for c = 2). A column that is too small
///    overshoots until damping limits the steps: R falls step by step, with q below 1/2 and l near
///    0.8. The test requires constant |l| and q over five steps (ten for a column that is too
///    small), and a gradient and a step length that fall by |l|, too. Without this, errors do not
///    shrink in proportion, as in a curved valley, or if points go to infinity (r = 1 / z has q =
///    3/4 at l = 1/2, but steps that double).
///
/// Changes of the cost near its rounding errors are ignored. The bounds are chosen such that
/// several thousand difficult solves with right Jacobians give no warning. So some wrong Jacobians
/// are not detected. Some have no signature: a column that is far too small makes damping
/// oscillate, as in any badly scaled problem. SpotCheck detects these.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iomanip>
#include <limits>
#include <sstream>

namespace bundle {
namespace {

// Decreases below this share of the cost may be rounding errors.
constexpr double kLadderNoise = 1e-10;
constexpr double kTailNoise = 1e-12;

// Limits of a ladder: the factor by which p has to fall, over rejected and over accepted steps; how
// closely p follows R from rung to rung; how constant 1 - q is, which with true derivatives falls
// like p; how wrong q is at its end; and, over accepted steps, how constant the gradient is and the
// number of rungs.
constexpr double kRejectedShrink = 32;
constexpr double kAcceptedShrink = 100;
constexpr double kRejectedRungFollows = 1.75;
constexpr double kAcceptedRungFollows = 1.25;
constexpr double kConstant = 4.0 / 3;
constexpr double kWrongBelow = 0.75;
constexpr double kWrongAbove = -1.5;
constexpr double kRadiusFalls = 0.8;
constexpr size_t kAcceptedRungs = 6;

// Limits of a tail: spread of |l| and q; how closely steps and gradient follow |l|; the margin
// inside the range that true derivatives exclude.
constexpr double kTailSpread = 0.03;
constexpr double kTailKeeps = 0.05;
constexpr double kTailMargin = 0.1;
// Limits for quick convergence, the sign of a column that is too large: number of steps;
// significant |l|; the change of R that shows m = 0. Limits for slow convergence, the sign of a
// column that is too small: more steps, with R falling.
constexpr size_t kQuickTail = 5;
constexpr double kQuickFrom = 0.2;
constexpr double kQuickTo = 0.7;
constexpr double kQuickRadiusChange = 1.5;
constexpr size_t kSlowTail = 10;
constexpr double kSlowTo = 0.85;

/// A tested step; the first record is the start, not a step.
struct Step {
  int iteration;
  bool accepted;
  double cost;
  double decrease;
  double predicted;  ///< p, NaN if unknown
  double quality;    ///< q
  double radius;     ///< R used to compute the step
  double length;
  double gradient_before;
  double gradient_after;
};

std::vector<Step> StepsOf(const std::vector<IterationRecord>& iterations) {
  std::vector<Step> steps;
  for (size_t k = 1; k < iterations.size(); ++k) {
    const IterationRecord& record = iterations[k];
    const double q = record.relative_decrease;
    const bool known = std::isfinite(q) && q != 0 && std::isfinite(record.cost_change) &&
                       record.cost_change / q > 0 && !record.changes_what_counts;
    steps.push_back({record.iteration, record.step_is_successful, record.cost, record.cost_change,
                     known ? record.cost_change / q : std::numeric_limits<double>::quiet_NaN(), q,
                     iterations[k - 1].trust_region_radius, record.step_norm,
                     iterations[k - 1].gradient_max_norm, record.gradient_max_norm});
  }
  return steps;
}

bool IsEvidence(const Step& step, double noise) {
  return std::isfinite(step.predicted) && std::abs(step.decrease) > noise * std::abs(step.cost);
}

bool IsConstant(double from, double to) { return to < kConstant * from && from < kConstant * to; }

/// True if p decreased from one step to the next because R did.
bool IsNextRung(const Step& above, const Step& below) {
  const double radii = below.radius / above.radius;
  const double follows = below.predicted / above.predicted / radii;
  const double bound = above.accepted ? kAcceptedRungFollows : kRejectedRungFollows;
  return radii < kRadiusFalls && follows < bound && follows > 1 / bound;
}

/// True if p fell between two rungs and 1 - q did not.
bool StaysWrong(const Step& top, const Step& bottom) {
  return bottom.quality < kWrongBelow && bottom.quality > kWrongAbove &&
         IsConstant(1 - top.quality, 1 - bottom.quality) &&
         std::abs(bottom.quality) < kConstant * std::abs(top.quality);
}

bool FromOnePoint(const std::vector<Step>& steps, size_t top, size_t bottom) {
  return std::none_of(steps.begin() + top, steps.begin() + bottom,
                      [](const Step& step) { return step.accepted; });
}

bool DownOneSlope(const std::vector<Step>& steps, size_t top, size_t bottom) {
  const double gradient = steps[top].gradient_before;
  return bottom - top + 1 >= kAcceptedRungs &&
         std::all_of(steps.begin() + top, steps.begin() + bottom + 1,
                     [&](const Step& step) { return IsConstant(gradient, step.gradient_before); });
}

/// Searches for the ladder's signature between `bottom` and a rung from `first` on.
std::string DescribeLadder(const std::vector<Step>& steps, size_t first, size_t bottom) {
  for (size_t top = first; top < bottom; ++top) {
    const double shrink = steps[top].predicted / steps[bottom].predicted;
    if (shrink < kRejectedShrink) return "";
    if (!FromOnePoint(steps, top, bottom) &&
        !(shrink > kAcceptedShrink && DownOneSlope(steps, top, bottom))) {
      continue;
    }
    if (!StaysWrong(steps[top], steps[bottom])) continue;
    std::ostringstream text;
    text << std::setprecision(2) << "while steps became shorter and the predicted decrease became "
         << shrink << " times smaller, the cost changed by " << steps[bottom].quality
         << " times the prediction, which tends to 1 with true derivatives"
         << " (iterations " << steps[top].iteration << " to " << steps[bottom].iteration << ")";
    return text.str();
  }
  return "";
}

std::string FindLadder(const std::vector<Step>& steps) {
  size_t first = 0;
  for (size_t k = 1; k < steps.size(); ++k) {
    const bool continues = IsEvidence(steps[k - 1], kLadderNoise) &&
                           IsEvidence(steps[k], kLadderNoise) && IsNextRung(steps[k - 1], steps[k]);
    if (!continues) {
      first = k;
      continue;
    }
    std::string found = DescribeLadder(steps, first, k);
    if (!found.empty()) return found;
  }
  return "";
}

struct Range {
  double lowest = std::numeric_limits<double>::infinity();
  double highest = -std::numeric_limits<double>::infinity();
  double sum = 0;
  int count = 0;

  void Add(double value) {
    lowest = std::min(lowest, value);
    highest = std::max(highest, value);
    sum += value;
    ++count;
  }
  double spread() const { return highest - lowest; }
  double mean() const { return sum / count; }
};

struct Tail {
  Range quality, rate, radius;
};

/// Measures `length` steps from `first` on; false if their convergence is not linear.
bool MeasureTail(const std::vector<Step>& steps, size_t first, size_t length, Tail* tail) {
  for (size_t k = first; k < first + length; ++k) {
    const Step& step = steps[k];
    if (!step.accepted || !IsEvidence(step, kTailNoise)) return false;
    tail->quality.Add(step.quality);
    tail->radius.Add(step.radius);
    if (k == first) continue;
    const double l = std::sqrt(step.decrease / steps[k - 1].decrease);
    if (std::abs(step.length / steps[k - 1].length - l) > kTailKeeps ||
        std::abs(step.gradient_after / step.gradient_before - l) > kTailKeeps) {
      return false;
    }
    tail->rate.Add(l);
  }
  return tail->quality.spread() < kTailSpread && tail->rate.spread() < kTailSpread;
}

/// True if true derivatives cannot converge at this rate with this q.
bool IsQuickLie(const Tail& tail) {
  const double l = tail.rate.mean(), q = tail.quality.mean();
  if (tail.rate.lowest < kQuickFrom || tail.rate.highest > kQuickTo) return false;
  if (q < 1 - l + kTailMargin) return false;
  const bool undamped = tail.radius.highest > kQuickRadiusChange * tail.radius.lowest;
  return (undamped && std::abs(q - (1 - l * l)) < kTailSpread) || q < (1 + l) / 2 - kTailMargin;
}

bool IsSlowLie(const Tail& tail) {
  const double l = tail.rate.mean();
  return tail.rate.lowest > kQuickTo && tail.rate.highest < kSlowTo &&
         tail.quality.lowest > 1 - l + kTailMargin && tail.quality.highest < 0.5;
}

std::string FindTail(const std::vector<Step>& steps, size_t length, bool (*is_lie)(const Tail&)) {
  for (size_t first = 0; first + length <= steps.size(); ++first) {
    Tail tail;
    if (!MeasureTail(steps, first, length, &tail) || !is_lie(tail)) continue;
    std::ostringstream text;
    text << std::setprecision(2) << "convergence was linear: each step reduced the error to "
         << tail.rate.mean() << " times its size, at " << tail.quality.mean()
         << " times the predicted decrease, which true derivatives exclude (iterations "
         << steps[first].iteration << " to " << steps[first + length - 1].iteration << ")";
    return text.str();
  }
  return "";
}

}  // namespace

std::string WatchConvergence(const std::vector<IterationRecord>& iterations,
                             const std::string& advice) {
  const std::vector<Step> steps = StepsOf(iterations);
  std::string seen = FindLadder(steps);
  if (seen.empty()) seen = FindTail(steps, kQuickTail, IsQuickLie);
  if (seen.empty()) seen = FindTail(steps, kSlowTail, IsSlowLie);
  if (seen.empty()) return "";
  return "A Jacobian may be wrong: " + seen + "; " + advice + ".";
}

}  // namespace bundle
