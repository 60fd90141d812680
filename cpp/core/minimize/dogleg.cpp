#include "core/minimize/dogleg.h"

#include "core/minimize/strategy.h"

/// The radius R bounds ||D d||. It is halved by a rejected step and by a step with a quality below
/// 1/4. After a step with a quality above 3/4, it becomes at least three times the step's length.
/// The directions depend on x alone: a rejected step costs one more candidate and no solution of
/// the normal equations.
///
/// The damping is only for nearly singular normal equations and is independent of R. It starts at
/// 1e-8. A failure or an invalid step multiplies it by ten, up to 1; an accepted step divides it by
/// five.

#include <algorithm>
#include <cmath>
#include <utility>

namespace bundle {

namespace {

constexpr double kMaxDamping = 1;
constexpr double kDampingFactor = 10;
constexpr double kPoorQuality = 0.25;
constexpr double kGoodQuality = 0.75;
constexpr double kExactly = 0;  // the forcing term: a path needs the exact Newton direction

}  // namespace

Step Dogleg::ComputeStep(LeastSquares* problem) {
  Step step;
  if (!directions_are_known_) FindDirections(problem, &step);
  if (step.status != LinearStatus::kSuccess) return step;
  const Combination best = path_(products_, radius_);
  length_ = best.length;
  step.candidate = problem->EvaluateDoglegStep(best.p, best.q);
  return step;
}

void Dogleg::FindDirections(LeastSquares* problem, Step* step) {
  step->status = LinearStatus::kFailure;
  step->num_iterations = -1;  // as in Ceres, if even the largest damping has already failed
  while (damping_ < kMaxDamping && step->status == LinearStatus::kFailure) {
    if (damping_has_changed_) problem->Linearize(damping_);
    damping_has_changed_ = false;
    NewtonResult newton = problem->SolveNewton(kExactly);
    step->status = newton.status;
    step->num_iterations = newton.num_iterations;
    step->message = std::move(newton.message);
    if (step->status == LinearStatus::kFailure) IncreaseDamping();
  }
  if (step->status != LinearStatus::kSuccess) return;
  products_ = problem->Products();
  directions_are_known_ = true;
}

void Dogleg::IncreaseDamping() {
  damping_ *= kDampingFactor;
  damping_has_changed_ = true;
}

void Dogleg::StepAccepted(double quality) {
  if (quality < kPoorQuality) radius_ *= 0.5;
  if (quality > kGoodQuality) radius_ = std::max(radius_, 3 * length_);
  damping_ = std::max(kMinDamping, 2 * damping_ / kDampingFactor);
  damping_has_changed_ = false;
  directions_are_known_ = false;
}

void Dogleg::StepRejected() { radius_ *= 0.5; }

void Dogleg::StepIsInvalid() {
  IncreaseDamping();
  directions_are_known_ = false;
}

/// Both doglegs in two dimensions. Every step is d = a p + b q, so that its length and the value of
/// the model m(d) = (J^T r)^T d + 1/2 d^T J^T J d depend only on the inner products of p and q.
/// Write <u, v> = u^T D^2 v and [u, v] = u^T J^T J v:
///
///   ||D d||^2 = a^2 <p,p> + 2 a b <p,q> + b^2 <q,q>,
///   m(d)      = a <p,p> + b <p,q> + 1/2 (a^2 [p,p] + 2 a b [p,q] + b^2 [q,q]),
///
/// the linear term because p = D^-2 J^T r makes (J^T r)^T d = <p, d>. Ceres keeps D p and D q as
/// vectors, its gradient_ and gauss_newton_step_.
///
/// Newton step. If <q,q> <= R^2 it is inside the radius, and both methods take it unchanged.
///
/// Cauchy point. Along -p the model is -t <p,p> + 1/2 t^2 [p,p], with its minimum at
/// t = alpha = <p,p> / [p,p].
///
/// Traditional dogleg. If the Cauchy point is outside, alpha^2 <p,p> >= R^2, the step is
/// -(R / sqrt <p,p>) p. Otherwise it is c + beta (q - c), c = -alpha p, on the sphere:
///
///   beta^2 <q-c,q-c> + 2 beta <c,q-c> + <c,c> - R^2 = 0,
///
/// whose positive root is computed without cancellation if <c,q-c> >= 0. Without damping in q, this
/// is always true by Kantorovich's inequality: the path leads outwards.
///
/// Subspace dogleg. In the orthonormal basis (of D-lengths)
///
///   u = p / P,  v = (q - t p) / Q,   P^2 = <p,p>,  t = <p,q> / <p,p>,  Q^2 = <q,q> - t <p,q>,
///
/// a step x u + y v has squared length x^2 + y^2, the gradient is (P, 0) and the curvature
///
///   A = [p,p] / P^2,  B = ([p,q] - t [p,p]) / (P Q),
///   C = ([q,q] - 2 t [p,q] + t^2 [p,p]) / Q^2.
///
/// With q outside, the minimum is on the sphere and satisfies, for a multiplier z > 0,
///
///   (A + z) x + B y = -P,  B x + (C + z) y = 0,   or   (x, y) = -P (C + z, -B) / det,
///   det = (A + z) (C + z) - B^2,                       x^2 + y^2 = R^2.
///
/// Ceres transforms the last equation to a quartic polynomial in z and tries all four roots.
/// Because the curvature is positive semidefinite, there is only one z > 0, and it belongs to the
/// minimum. Write w = (C + z, -B), so that the length is n = P ||w|| / det. 1/n is concave and
/// increasing in z (J. J. More, D. C. Sorensen: Computing a Trust Region Step, 1983). So Newton's
/// method for 1/n = 1/R, started left of the solution, converges to it from the left. Its step is
///
///   z += (n - R) / R * (x, y)^2 / ((x, y) M^-1 (x, y)),     M = [[A + z, B], [B, C + z]],
///      = (P ||w|| / R - det) ||w||^2 / (w^T adj(M) w),
///
/// with the determinant multiplied out, because M may be singular at z = 0. A start left of the
/// solution is max(0, P / R - e), with e the larger eigenvalue of the curvature, since n >= P / (e
/// + z). It is positive if w is zero at z = 0.
///
/// The products give the sine of the angle between p and q only to half of the digits. Below that,
/// p and q count as parallel and the step goes along -p. The angle between -p and (x, y), whose
/// tangent is B / (C + z), only decreases from the Newton step to z. So this error is also below
/// half of the digits.

namespace {

constexpr double kParallel = 1e-14;  // sine squared
constexpr int kMaxSteps = 50;        // of Newton's method; ten at most in the tests

bool NewtonIsInside(const DoglegProducts& products, double radius) {
  return std::sqrt(products.d_qq) <= radius;
}

Combination WholeNewtonStep(const DoglegProducts& products) {
  return {0, 1, std::sqrt(products.d_qq)};
}

Combination AlongGradient(const DoglegProducts& products, double radius) {
  return {-radius / std::sqrt(products.d_pp), 0, radius};
}

/// The model over steps x u + y v: gradient (slope, 0), curvature [[a, b], [b, c]].
struct PlaneModel {
  double slope, a, b, c;
};

struct PlaneStep {
  double x, y;
};

/// The minimum of the model at distance `radius`.
PlaneStep MinimumOnCircle(const PlaneModel& model, double radius) {
  const double largest_curvature =
      (model.a + model.c) / 2 + std::hypot((model.a - model.c) / 2, model.b);
  double z = std::max(0.0, model.slope / radius - largest_curvature);
  double x = 1, y = 0;
  for (int k = 0; k < kMaxSteps; ++k) {
    const double a = model.a + z, c = model.c + z;
    x = c;
    y = -model.b;
    const double squared = x * x + y * y;
    const double curvature = c * x * x - 2 * model.b * x * y + a * y * y;
    const double change =
        (model.slope * std::sqrt(squared) / radius - (a * c - model.b * model.b)) * squared /
        curvature;
    if (!(z + change > z)) break;
    z += change;
  }
  const double scale = -radius / std::hypot(x, y);
  return {scale * x, scale * y};
}

}  // namespace

Combination TraditionalDogleg(const DoglegProducts& products, double radius) {
  if (NewtonIsInside(products, radius)) return WholeNewtonStep(products);
  const double alpha = products.d_pp / products.j_pp;
  const double cauchy = alpha * alpha * products.d_pp;
  if (cauchy >= radius * radius) return AlongGradient(products, radius);
  const double cross = -alpha * products.d_pq;
  const double along = cross - cauchy;
  const double leg = cauchy - 2 * cross + products.d_qq;
  const double left = radius * radius - cauchy;
  const double root = std::sqrt(along * along + leg * left);
  const double beta = left / (root + along);
  return {-alpha * (1 - beta), beta, radius};
}

Combination SubspaceDogleg(const DoglegProducts& products, double radius) {
  if (NewtonIsInside(products, radius)) return WholeNewtonStep(products);
  const double t = products.d_pq / products.d_pp;
  const double q_squared = products.d_qq - t * products.d_pq;
  if (!(q_squared > kParallel * products.d_qq)) return AlongGradient(products, radius);
  const double p_length = std::sqrt(products.d_pp), q_length = std::sqrt(q_squared);
  PlaneModel model;
  model.slope = p_length;
  model.a = products.j_pp / products.d_pp;
  model.b = (products.j_pq - t * products.j_pp) / (p_length * q_length);
  model.c = (products.j_qq - 2 * t * products.j_pq + t * t * products.j_pp) / q_squared;
  const PlaneStep best = MinimumOnCircle(model, radius);
  const double q = best.y / q_length;
  return {best.x / p_length - t * q, q, radius};
}

}  // namespace bundle
