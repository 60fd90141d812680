#include <bundle/checkable.h>
#include <ceres/sized_cost_function.h>

#include <memory>
#include <stdexcept>

namespace {

/// r = a b, whose derivative by b is never written.
class Forgetful final : public ceres::SizedCostFunction<1, 2> {
 public:
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    residuals[0] = parameters[0][0] * parameters[0][1];
    if (jacobians != nullptr && jacobians[0] != nullptr) jacobians[0][0] = parameters[0][1];
    return true;
  }
};

class Throwing final : public ceres::SizedCostFunction<1, 2> {
 public:
  bool Evaluate(double const* const*, double*, double**) const override {
    throw std::runtime_error("no map loaded");
  }
};

}  // namespace

PYBIND11_MODULE(odd_costs, m) {
  m.def("forgetful", [] { return bundle::Checkable(std::make_unique<Forgetful>()); });
  m.def("throwing", [] { return bundle::Checkable(std::make_unique<Throwing>()); });
  m.def("nothing", [] { return bundle::Checkable(nullptr); });
}
