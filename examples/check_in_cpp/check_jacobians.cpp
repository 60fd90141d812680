#include <bundle/check.h>
#include <bundle/jet_cost.h>
#include <ceres/dynamic_cost_function.h>
#include <ceres/manifold.h>
#include <ceres/rotation.h>

#include <Eigen/Core>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace {

/// Ranges from a position to beacons: as many residuals as beacons, known at run time only.
class Ranges final : public ceres::DynamicCostFunction {
 public:
  Ranges(std::vector<Eigen::Vector2d> beacons, double sign)
      : beacons_(std::move(beacons)), sign_(sign) {
    AddParameterBlock(2);
    SetNumResiduals(static_cast<int>(beacons_.size()));
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const Eigen::Vector2d> position(parameters[0]);
    for (size_t i = 0; i < beacons_.size(); ++i) {
      const Eigen::Vector2d offset = position - beacons_[i];
      residuals[i] = offset.norm();
      if (jacobians == nullptr || jacobians[0] == nullptr) continue;
      jacobians[0][2 * i] = offset.x() / residuals[i];
      jacobians[0][2 * i + 1] = sign_ * offset.y() / residuals[i];
    }
    return true;
  }

 private:
  const std::vector<Eigen::Vector2d> beacons_;
  const double sign_;
};

/// A turned point, as a functor: its Jacobian is by Jets.
struct Turned {
  template <typename T>
  bool operator()(T const* const* parameters, T* residuals) const {
    const T point[3] = {T(1.0), T(-2.0), T(3.0)};
    ceres::QuaternionRotatePoint(parameters[0], point, residuals);
    for (int i = 0; i < 3; ++i) residuals[i] *= parameters[1][0];
    return true;
  }
};

/// A value that passes through double has no derivative.
double ToDouble(double x) { return x; }
template <typename T, int N>
double ToDouble(const ceres::Jet<T, N>& x) {
  return static_cast<double>(x.a);
}

struct Leaking {
  template <typename T>
  bool operator()(T const* const* parameters, T* residuals) const {
    residuals[0] = T(ToDouble(parameters[0][0])) * parameters[1][0];
    return true;
  }
};

void Expect(bool is_true, const std::string& what, const bundle::GradientCheck& check) {
  std::cout << what << "\n" << check << "\n\n";
  if (!is_true) std::exit(1);
}

}  // namespace

int main() {
  const double position[2] = {0.3, -0.4};
  const std::vector<Eigen::Vector2d> beacons = {{3, 1}, {-2, 4}, {0, -5}, {6, 6}};
  bundle::CheckOptions options;
  options.names = {"position"};
  const auto ranges = [&](double sign) {
    return bundle::CheckGradients(Ranges(beacons, sign), {position}, {}, options);
  };
  Expect(ranges(1).ok(), "sizes at run time", ranges(1));
  Expect(ranges(-1).findings()[0].kind == "sign", "a sign error", ranges(-1));

  const double quaternion[4] = {0.5, -0.5, 0.5, 0.5}, scale[1] = {1.5};
  const ceres::QuaternionManifold manifold;
  const bundle::JetCost<5, Turned> turned({}, {4, 1}, 3);
  const bundle::GradientCheck jets =
      bundle::CheckGradients(turned, {quaternion, scale}, {&manifold, nullptr});
  Expect(jets.ok(), "Jets and a manifold", jets);

  const bundle::JetCost<5, Turned, float> single({}, {4, 1}, 3);
  const bundle::GradientCheck floats =
      bundle::CheckGradients(single, {quaternion, scale}, {&manifold, nullptr});
  Expect(floats.ok() && floats.tolerance() == 1e-3, "single precision", floats);

  const double a[1] = {2}, b[1] = {3};
  const bundle::GradientCheck leak =
      bundle::CheckGradients(bundle::JetCost<2, Leaking>({}, {1, 1}, 1), {a, b});
  Expect(leak.findings()[0].kind == "zero", "a value that passes through double", leak);

  try {
    const bundle::JetCost<4, Turned> another({}, {4, 1}, 3);
  } catch (const std::invalid_argument& error) {
    std::cout << error.what() << "\n";
    return 0;
  }
  return 1;
}
