#pragma once

/// Classic test functions of least squares (J. J. More, B. S. Garbow, K. E. Hillstrom: Testing
/// Unconstrained Optimization Software, 1981) and some unpleasant ones.

#include <Eigen/Core>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

namespace bundle {

struct ClassicFunction {
  using Vector = Eigen::VectorXd;

  std::string name;
  std::vector<double> start;
  int num_residuals = 0;
  /// Writes residuals and Jacobian at x; both have their size already.
  std::function<void(const Vector& x, Vector* r, Eigen::MatrixXd* j)> evaluate;
  std::vector<double> lower = {}, upper = {};  ///< bounds of x; empty: none
};

inline ClassicFunction Rosenbrock() {
  return {"Rosenbrock", {-1.2, 1}, 2, [](const auto& x, auto* r, auto* j) {
            *r << 10 * (x[1] - x[0] * x[0]), 1 - x[0];
            *j << -20 * x[0], 10, -1, 0;
          }};
}

/// Singular at its minimum.
inline ClassicFunction Powell() {
  return {"Powell", {3, -1, 0, 1}, 4, [](const auto& x, auto* r, auto* j) {
            const double u = x[1] - 2 * x[2], v = x[0] - x[3];
            const double s = std::sqrt(5.0), t = std::sqrt(10.0);
            *r << x[0] + 10 * x[1], s * (x[2] - x[3]), u * u, t * v * v;
            *j << 1, 10, 0, 0, 0, 0, s, -s, 0, 2 * u, -4 * u, 0, 2 * t * v, 0, 0, -2 * t * v;
          }};
}

inline ClassicFunction Wood() {
  return {"Wood", {-3, -1, -3, -1}, 6, [](const auto& x, auto* r, auto* j) {
            const double s = std::sqrt(90.0), t = std::sqrt(10.0), u = 1 / t;
            *r << 10 * (x[1] - x[0] * x[0]), 1 - x[0], s * (x[3] - x[2] * x[2]), 1 - x[2],
                t * (x[1] + x[3] - 2), u * (x[1] - x[3]);
            *j << -20 * x[0], 10, 0, 0, -1, 0, 0, 0, 0, 0, -2 * s * x[2], s, 0, 0, -1, 0, 0, t, 0,
                t, 0, u, 0, -u;
          }};
}

inline ClassicFunction Beale() {
  return {"Beale", {1, 1}, 3, [](const auto& x, auto* r, auto* j) {
            const double y = x[1], y2 = y * y;
            *r << 1.5 - x[0] * (1 - y), 2.25 - x[0] * (1 - y2), 2.625 - x[0] * (1 - y2 * y);
            *j << y - 1, x[0], y2 - 1, 2 * x[0] * y, y2 * y - 1, 3 * x[0] * y2;
          }};
}

/// Badly scaled: the minimum is at (1e6, 2e-6).
inline ClassicFunction Brown() {
  return {"Brown", {1, 1}, 3, [](const auto& x, auto* r, auto* j) {
            *r << x[0] - 1e6, x[1] - 2e-6, x[0] * x[1] - 2;
            *j << 1, 0, 0, 1, x[1], x[0];
          }};
}

/// Linear and ill-conditioned: 4e5.
inline ClassicFunction Hilbert() {
  return {"Hilbert", {1, -2, 3, -4, 5}, 9, [](const auto& x, auto* r, auto* j) {
            for (int i = 0; i < 9; ++i) {
              for (int k = 0; k < 5; ++k) (*j)(i, k) = 1.0 / (1 + i + k);
            }
            *r = *j * x;
            for (int i = 0; i < 9; ++i) (*r)[i] -= std::cos(i);
          }};
}

/// A logarithm of what the first step makes negative.
inline ClassicFunction NanInPlaces() {
  return {"NanInPlaces", {5, 1}, 3, [](const auto& x, auto* r, auto* j) {
            *r << std::log(x[0]) + 2, x[1] * x[0] - 1, 0.1 * (x[1] - 3);
            *j << 1 / x[0], 0, x[1], x[0], 0, 0.1;
          }};
}

/// Two of three parameters matter as their sum only.
inline ClassicFunction RankDeficient() {
  return {"RankDeficient", {1, 0.5, 2}, 4, [](const auto& x, auto* r, auto* j) {
            const double sum = x[0] + x[1], e = std::exp(sum);
            *r << e - 2, sum * sum - 1, std::sin(x[2]) - 0.3, x[2] * sum;
            *j << e, e, 0, 2 * sum, 2 * sum, 0, 0, 0, std::cos(x[2]), x[2], x[2], sum;
          }};
}

/// Every direction is the gradient's.
inline ClassicFunction OneParameter() {
  return {"OneParameter", {10}, 2, [](const auto& x, auto* r, auto* j) {
            *r << std::exp(x[0]) - 3, x[0] - 2;
            *j << std::exp(x[0]), 1;
          }};
}

/// The same function with residuals `factor` times as large, which makes a trust region of the same
/// radius as many times smaller.
inline ClassicFunction Times(int factor, ClassicFunction function) {
  function.name += "Times" + std::to_string(factor);
  function.evaluate = [factor, inner = std::move(function.evaluate)](const auto& x, auto* r,
                                                                     auto* j) {
    inner(x, r, j);
    *r *= factor;
    *j *= factor;
  };
  return function;
}

inline ClassicFunction Within(const std::vector<double>& lower, const std::vector<double>& upper,
                              const std::string& name, ClassicFunction function) {
  function.name += name;
  function.lower = lower;
  function.upper = upper;
  return function;
}

inline ClassicFunction From(const std::vector<double>& start, ClassicFunction function) {
  function.start = start;
  return function;
}

inline std::vector<ClassicFunction> ClassicFunctions() {
  std::vector<ClassicFunction> functions = {Rosenbrock(),  Powell(),        Wood(),
                                            Beale(),       Brown(),         Hilbert(),
                                            NanInPlaces(), RankDeficient(), OneParameter()};
  const std::vector<ClassicFunction> plain = functions;
  for (const ClassicFunction& function : plain) functions.push_back(Times(100000, function));
  return functions;
}

constexpr double kNoBound = std::numeric_limits<double>::infinity();

/// Bounds that are reached and kept, reached and left, never reached; starts on, outside, and in a
/// corner of them.
inline std::vector<ClassicFunction> BoundedFunctions() {
  const double none = kNoBound;
  return {
      Within({-2, -none}, {0.5, none}, "Below", Rosenbrock()),
      Within({-none, 0.9}, {none, none}, "LeavesABound", Rosenbrock()),
      Within({-100}, {100}, "Inactive", From({-5}, OneParameter())),
      Within({-1.2, 0.5}, {0.7, 1}, "OnTwoBounds", Rosenbrock()),
      Within({-1, -0.5}, {0.9, 0.6}, "Outside", Rosenbrock()),
      Within({0.25, -1}, {0.5, 2}, "Corner", From({0.5, 0.25}, Rosenbrock())),
      Within({-none, -1, 0.5, -none}, {none, none, none, 0.75}, "Bounded", Powell()),
      Within({-3, -1, -3, -1}, {none, 0.8, none, 0.8}, "Bounded", Wood()),
      Within({0, 0.6}, {2, 1}, "Bounded", Beale()),
      Within({-none, -none}, {none, 0.25}, "OneBound", Beale()),
      Within({0, 1e-5}, {1e5, 1}, "Bounded", Brown()),
      Within({-none, -none, -none, -none, -none}, {2, none, none, none, none}, "Bounded",
             Hilbert()),
      Within({0.2, -none}, {none, 2}, "Bounded", NanInPlaces()),
      Within({-none, 0.4, 1}, {0.2, none, none}, "Bounded", RankDeficient()),
      Within({1.5}, {none}, "Bounded", OneParameter()),
  };
}

}  // namespace bundle
