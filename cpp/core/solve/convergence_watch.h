#pragma once

/// The signature of a lying Jacobian in the iterations of a solve.
///
/// A wrong Jacobian rarely crashes: the cost still falls, only less than promised. Two things about
/// a trust region method with true derivatives cannot be had with false ones, and both can be read
/// off the trace alone. Notation: f the cost, g its gradient J^T r, G = J^T J, H the true Hessian
/// of f, d a step, p = -g^T d - 1/2 d^T G d > 0 the decrease that the model predicts, q = (actual
/// decrease) / p Ceres' relative_decrease, R the trust region radius, m = D / (R G) the damping of
/// a direction.
///
/// 1. Shorter steps make the model right. To second order
///
///      (1 - q) p = 1/2 d^T (H - G) d,
///
///    which vanishes faster than p: once R is so small that p is proportional to it (d follows the
///    scaled gradient), 1 - q is proportional to R as well, whatever the problem. With a gradient
///    J^T r that is not f's, q tends to (true slope) / (promised slope) along d instead: it
///    settles, often below zero. The watch looks for a *ladder*: successive steps, each with a
///    smaller R and a p that shrinks with it, over which 1 - q stays what it was. Rejected steps
///    all start from one point, and p falling 32 times is enough; accepted ones move on, so p has
///    to fall 100 times over six rungs at one gradient. Two honest things keep 1 - q up for a
///    while, and neither is taken for a lie: where the cost jumps or saturates (a point passes
///    behind its camera; Tukey's loss) the actual change does not shrink with p, so that |q| grows;
///    and undamped steps do not shrink. Outliers, bad starts and valleys make R oscillate, where q
///    recovers as R falls.
///
/// 2. A linear tail tells its rate twice. Along the slowest direction an error e becomes l e. True
///    derivatives give a step of -H e / (G (1 + m)), hence
///
///      l = 1 - H / (G (1 + m)),     q = (1 + l) (1 + m) / (1 + 2 m),   in [(1 + l) / 2, 1 + l],
///
///    with l of either sign: slow progress shows as q near 2 (robust losses, where G exceeds H), as
///    q near 0 (steps that overshoot) or, damped, as q = 1. Decreases fall by l^2 a step, so that
///    |l| is seen as well, and true derivatives exclude every q between 1 - |l| and (1 + |l|) / 2;
///    with m = 0, which shows where R changed and l did not, everything between 1 - |l| and 1 +
///    |l|. A Jacobian column that is c times too large makes steps 1 / c as long at the promise of
///    whole ones: l = 1 - 1 / c and q = 1 - l^2 (1/2 and 3/4 for c = 2). One too small overshoots
///    until damping holds it: R falls step by step, at q below 1/2 and l near 0.8. The watch wants
///    |l| and q constant over five steps, ten of the second kind, and gradient and step length to
///    fall by |l| too. Without that no error shrinks in proportion, as in a curved valley, or where
///    points go to infinity (r = 1 / z has q = 3/4 at l = 1/2, but steps that double).
///
/// Changes of the cost near its rounding errors are no evidence. The bounds are set where several
/// thousand honest solves, made as hard as one can, keep silent; that costs some
/// lies. Those that leave no signature (a column far too small makes damping oscillate as any badly
/// scaled problem does) are for the spot check to find (spot_check.h).

#include <string>
#include <vector>

#include "core/solve/summary.h"

namespace bundle {

/// One sentence that says what was seen and names `bundle check`; "" if nothing was.
std::string WatchConvergence(const std::vector<IterationRecord>& iterations);

}  // namespace bundle
