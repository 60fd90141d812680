#include "core/minimize/projected_line_search.h"

/// A step d that ignores the bounds leads to P(x + d), with P the projection onto them. The model
/// of the cost does not include the projection, so that P(x + d) may have a higher cost than
/// predicted. The search goes back along the path
///
///   phi(a) = f(P(x + a d)),  a <= 1,
///
/// to the first a with phi(a) <= f(x) + 1e-4 a s, s = d^T J^T r at x (Armijo's condition). The next
/// a is the minimum, between a/1000 and 0.6 a, of a polynomial. It interpolates phi(0), phi at the
/// last two values of a, and their slopes: of degree 3, from the second search step on of degree 5.
/// If phi(a) is not finite, the next value is a/2. The search gives up, and the full step is used,
/// after 20 values or if a ||d||_inf < 1e-9.
///
/// This is ceres::internal::TrustRegionMinimizer::DoLineSearch, with its conventions:
///
/// * The slope at a is d^T J^T r at P(x + a d), with the d from before the projection.
/// * The quality of a shortened step is measured by the model cost change of the full step.
///
/// Ceres searches along every step. If the trust region would accept d, the search ends at a = 1.
/// Therefore, this code searches only along steps that the trust region would reject. In most
/// iterations it takes no time. Neither strategy goes beyond the minimum of the model m(t) = t s +
/// t^2 c / 2 along its own step, so that -s / c >= 1, and the model cost change -s - c / 2 is at
/// least -s / 2. An accepted step lowers the cost by more than a thousandth of that: by more than
/// 1e-4 (-s).

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/dense/decompositions.h"

namespace bundle {
namespace {

// Ceres' defaults.
constexpr double kSufficientDecrease = 1e-4;
constexpr double kMaxContraction = 1e-3;
constexpr double kMinContraction = 0.6;
constexpr double kMinStepSize = 1e-9;
constexpr int kMaxValues = 20;

struct Sample {
  double a = 0, value = 0, slope = 0;
  bool is_valid = false;
};

/// Coefficients of 1, a, a^2, ...
using Polynomial = Eigen::VectorXd;

Polynomial Interpolate(const std::array<Sample, 3>& samples) {
  const auto n = 2 * std::count_if(samples.begin(), samples.end(),
                                   [](const Sample& sample) { return sample.is_valid; });
  Eigen::MatrixXd conditions = Eigen::MatrixXd::Zero(n, n);
  Eigen::VectorXd values(n);
  int row = 0;
  for (const Sample& sample : samples) {
    if (!sample.is_valid) continue;
    for (int k = 0; k < n; ++k) conditions(row, k) = std::pow(sample.a, k);
    for (int k = 1; k < n; ++k) conditions(row + 1, k) = k * std::pow(sample.a, k - 1);
    values[row] = sample.value;
    values[row + 1] = sample.slope;
    row += 2;
  }
  return SolveByFullPivoting(conditions, values);
}

double Evaluate(const Polynomial& polynomial, double a) {
  double value = 0;
  for (Eigen::Index k = polynomial.size() - 1; k >= 0; --k) value = value * a + polynomial[k];
  return value;
}

Polynomial Derivative(const Polynomial& polynomial) {
  Polynomial derivative(polynomial.size() - 1);
  for (int k = 1; k < polynomial.size(); ++k) derivative[k - 1] = k * polynomial[k];
  return derivative;
}

/// Root of a polynomial that is monotonic from `low` to `high`.
double Bisect(const Polynomial& polynomial, double low, double high) {
  const bool rises = Evaluate(polynomial, low) < 0;
  for (;;) {
    const double middle = (low + high) / 2;
    if (!(low < middle && middle < high)) return middle;
    ((Evaluate(polynomial, middle) < 0) == rises ? low : high) = middle;
  }
}

/// Roots of a polynomial between `low` and `high`, ascending: at most one between two roots of its
/// derivative.
std::vector<double> SignChanges(const Polynomial& polynomial, double low, double high) {
  std::vector<double> changes;
  if (polynomial.size() < 2) return changes;
  std::vector<double> ends = SignChanges(Derivative(polynomial), low, high);
  ends.push_back(high);
  for (const double end : ends) {
    if ((Evaluate(polynomial, low) < 0) != (Evaluate(polynomial, end) < 0)) {
      changes.push_back(Bisect(polynomial, low, end));
    }
    low = end;
  }
  return changes;
}

/// Minimum of a polynomial in [low, high]: at an end or at a root of its derivative. Returns the
/// middle if its values are NaN.
double Minimum(const Polynomial& polynomial, double low, double high) {
  std::vector<double> candidates = SignChanges(Derivative(polynomial), low, high);
  candidates.push_back(low);
  candidates.push_back(high);
  double best = (low + high) / 2;
  for (const double a : candidates) {
    if (Evaluate(polynomial, a) < Evaluate(polynomial, best)) best = a;
  }
  return best;
}

}  // namespace

void SearchAlongStep(double cost, LeastSquares* problem, Candidate* candidate) {
  const StepLine line = problem->LineAlongStep();
  const Sample start{0, cost, line.slope, true};
  Candidate shorter = *candidate;
  const auto value = [](const Candidate& at) { return at.cost + at.held_cost; };
  Sample previous, last{1, value(*candidate), 0, std::isfinite(candidate->cost)};
  for (int num_values = 1;
       !last.is_valid || last.value > cost + kSufficientDecrease * line.slope * last.a;
       ++num_values) {
    double a = last.a / 2;
    if (last.is_valid) {
      last.slope = problem->SlopeAtCandidate();
      last.is_valid = std::isfinite(last.slope);
    }
    if (last.is_valid) {
      a = Minimum(Interpolate({start, last, previous}), kMaxContraction * last.a,
                  kMinContraction * last.a);
    }
    if (num_values == kMaxValues || a * line.max_norm < kMinStepSize) {
      problem->EvaluateAlongStep(1);
      return;
    }
    previous = last;
    shorter = problem->EvaluateAlongStep(a);
    last = {a, value(shorter), 0, std::isfinite(shorter.cost)};
  }
  shorter.model_cost_change = candidate->model_cost_change;
  *candidate = shorter;
}

}  // namespace bundle
