#include "core/ceres/losses.h"

#include <algorithm>
#include <memory>
#include <vector>

#include "core/ceres/ceres_version.h"

namespace bundle {

namespace {

/// A cost function with constant residual and Jacobian.
class ConstantCost final : public ceres::CostFunction {
 public:
  ConstantCost(int rows, int columns, const double* residual, const double* jacobian)
      : residual_(residual, residual + rows), jacobian_(jacobian, jacobian + rows * columns) {
    set_num_residuals(rows);
    mutable_parameter_block_sizes()->push_back(columns);
  }

  bool Evaluate(double const* const* /*parameters*/, double* residual,
                double** jacobians) const override {
    std::copy(residual_.begin(), residual_.end(), residual);
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      std::copy(jacobian_.begin(), jacobian_.end(), jacobians[0]);
    }
    return true;
  }

 private:
  const std::vector<double> residual_;
  const std::vector<double> jacobian_;
};

class ConstantLoss final : public ceres::LossFunction {
 public:
  explicit ConstantLoss(const double* rho) : rho_(rho) {}

  void Evaluate(double /*squared_norm*/, double* rho) const override {
    std::copy(rho_, rho_ + 3, rho);
  }

 private:
  const double* rho_;
};

}  // namespace

void EvaluateLoss(LossType type, double scale, int64_t count, const double* squared_norms,
                  double* values) {
  const std::unique_ptr<ceres::LossFunction> made = MakeLoss(type, scale);
  const ceres::TrivialLoss trivial;
  const ceres::LossFunction* loss = &trivial;
  if (made != nullptr) loss = made.get();
  for (int64_t i = 0; i < count; ++i) loss->Evaluate(squared_norms[i], values + 3 * i);
}

void CorrectWithCeres(const double* rho, int rows, int columns, double* residual,
                      double* jacobian) {
  std::vector<double> parameters(columns);
  ceres::Problem problem;  // owns the cost function and the loss
  problem.AddResidualBlock(new ConstantCost(rows, columns, residual, jacobian),
                           new ConstantLoss(rho), parameters.data());
  ceres::Problem::EvaluateOptions options;
  options.apply_loss_function = true;
  std::vector<double> residuals;
  ceres::CRSMatrix matrix;  // one dense block, whose values are row-major
  problem.Evaluate(options, nullptr, &residuals, nullptr, &matrix);
  std::copy(residuals.begin(), residuals.end(), residual);
  std::copy(matrix.values.begin(), matrix.values.end(), jacobian);
}

std::unique_ptr<ceres::LossFunction> MakeLoss(LossType type, double scale) {
  switch (type) {
    case LossType::kTrivial:
      return nullptr;
    case LossType::kHuber:
      return std::make_unique<ceres::HuberLoss>(scale);
    case LossType::kSoftL1:
      return std::make_unique<ceres::SoftLOneLoss>(scale);
    case LossType::kCauchy:
      return std::make_unique<ceres::CauchyLoss>(scale);
    case LossType::kArctan:
      // This loss of Ceres compares s, not its square root, with the scale.
      return std::make_unique<ceres::ArctanLoss>(scale * scale);
    case LossType::kTukey:
      return std::make_unique<ceres::TukeyLoss>(scale);
  }
  return nullptr;
}

}  // namespace bundle
