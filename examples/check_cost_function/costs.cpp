#include <bundle/checkable.h>
#include <ceres/sized_cost_function.h>

#include <Eigen/Core>
#include <memory>

namespace {

/// Where a camera with focal length f and radial distortion k sees a point (x, y, z) of its own
/// frame, minus where it was observed, in pixels:
///
///   r = f (1 + k |p|^2) p - observed,  p = (x, y) / z
///
/// Blocks: the camera (f, k), the point.
class RadialCost : public ceres::SizedCostFunction<2, 2, 3> {
 public:
  RadialCost(double u, double v) : observed_(u, v) {}

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const double f = parameters[0][0], k = parameters[0][1];
    const Eigen::Map<const Eigen::Vector3d> point(parameters[1]);
    if (point.z() <= 0) return false;  // Behind the camera there is no image.
    const Eigen::Vector2d p = point.head<2>() / point.z();
    const double distortion = 1 + k * p.squaredNorm();
    Eigen::Map<Eigen::Vector2d>(residuals, 2) = f * distortion * p - observed_;
    if (jacobians == nullptr) return true;
    if (jacobians[0] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, 2, Eigen::RowMajor>> d_camera(jacobians[0]);
      d_camera.col(0) = distortion * p;
      d_camera.col(1) = f * p.squaredNorm() * p;
    }
    if (jacobians[1] != nullptr) {
      const Eigen::Matrix2d d_p =
          f * (distortion * Eigen::Matrix2d::Identity() + 2 * k * p * p.transpose());
      Eigen::Map<Eigen::Matrix<double, 2, 3, Eigen::RowMajor>> d_point(jacobians[1]);
      d_point.leftCols<2>() = d_p / point.z();
      d_point.col(2) = -d_p * p / point.z();
    }
    return true;
  }

 private:
  const Eigen::Vector2d observed_;
};

/// The same with a mistake to be found: d(1/z)/dz without its minus.
class RadialCostWithSignError final : public RadialCost {
 public:
  using RadialCost::RadialCost;

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (!RadialCost::Evaluate(parameters, residuals, jacobians)) return false;
    if (jacobians != nullptr && jacobians[1] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 2, 3, Eigen::RowMajor>>(jacobians[1]).col(2) *= -1;
    }
    return true;
  }
};

}  // namespace

PYBIND11_MODULE(costs, m) {
  m.def("radial",
        [](double u, double v) { return bundle::Checkable(std::make_unique<RadialCost>(u, v)); });
  m.def("radial_with_sign_error", [](double u, double v) {
    return bundle::Checkable(std::make_unique<RadialCostWithSignError>(u, v));
  });
}
