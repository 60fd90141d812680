#include "bindings/graph_from_python.h"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "bindings/arrays.h"
#include "bindings/options_from_python.h"
#include "bindings/python_factor.h"
#include "core/cameras/registry.h"
#include "core/error.h"
#include "core/factors/attitude_factors.h"
#include "core/factors/factor.h"
#include "core/factors/image_imu_factor.h"
#include "core/factors/imu_factor.h"
#include "core/factors/linear_prior.h"
#include "core/factors/measurement_factors.h"
#include "core/factors/twist_tie.h"
#include "core/factors/velocity_factor.h"

namespace py = pybind11;

namespace {

std::vector<double> Numbers(const py::handle& object) {
  const auto array = py::cast<CastArray<double>>(object);
  return std::vector<double>(array.data(), array.data() + array.size());
}

/// Makes a factor from its description and its variables.
class FactorReader {
 public:
  FactorReader(const py::tuple& given, const std::vector<bundle::Block>& blocks)
      : kind_(py::cast<std::string>(given[0])), arguments_(py::cast<py::tuple>(given[5])) {
    head_.name = py::cast<std::string>(given[1]);
    head_.blocks = py::cast<std::vector<int>>(given[2]);
    head_.loss = LossFromName(py::cast<std::string>(given[3]));
    head_.loss_scale = py::cast<double>(given[4]);
    for (const int b : head_.blocks) {
      const bundle::Block& block = blocks.at(b);
      retractions_.push_back(block.retraction);
      start_.push_back(block.value.data());
    }
  }

  std::unique_ptr<bundle::Factor> Read() const {
    if (kind_ == "prior") {
      return std::make_unique<bundle::PriorFactor>(head_, retractions_.at(0), At(0), At(1));
    }
    if (kind_ == "scalar_prior") {
      return std::make_unique<bundle::ScalarPriorFactor>(
          head_, retractions_.at(0), py::cast<int>(arguments_[0]), py::cast<double>(arguments_[1]),
          py::cast<double>(arguments_[2]), py::cast<bool>(arguments_[3]));
    }
    if (kind_ == "between") {
      return std::make_unique<bundle::BetweenFactor>(head_, retractions_.at(0), At(0), At(1));
    }
    if (kind_ == "relative_pose") {
      return std::make_unique<bundle::RelativePoseFactor>(head_, At(0), At(1));
    }
    if (kind_ == "twist_tie") {
      return std::make_unique<bundle::TwistTieFactor>(head_, py::cast<double>(arguments_[0]),
                                                      py::cast<double>(arguments_[1]),
                                                      py::cast<double>(arguments_[2]));
    }
    if (kind_ == "position") {
      return std::make_unique<bundle::PositionFactor>(head_, At(0), At(1), At(2), At(3));
    }
    if (kind_ == "velocity") {
      return std::make_unique<bundle::VelocityFactor>(head_, At(0), At(1), At(2));
    }
    if (kind_ == "direction") {
      return std::make_unique<bundle::DirectionFactor>(head_, At(0), At(1),
                                                       py::cast<double>(arguments_[2]));
    }
    if (kind_ == "rotation") {
      return std::make_unique<bundle::RotationFactor>(head_, At(0), At(1));
    }
    if (kind_ == "heading") {
      return std::make_unique<bundle::HeadingFactor>(head_, At(0), py::cast<double>(arguments_[1]),
                                                     py::cast<double>(arguments_[2]));
    }
    if (kind_ == "reprojection") {
      const auto model = py::cast<std::string>(arguments_[0]);
      const bundle::CameraModel* found = bundle::FindCameraModel(model);
      if (found == nullptr) {
        throw bundle::InputError(head_.name + ": model: there is no camera model " + model);
      }
      return std::make_unique<bundle::ReprojectionFactor>(head_, *found, At(1), At(2));
    }
    if (kind_ == "linear") {
      std::vector<std::vector<double>> points;
      for (const py::handle& point : py::cast<py::sequence>(arguments_[0])) {
        points.push_back(Numbers(point));
      }
      return std::make_unique<bundle::LinearPrior>(head_, retractions_, std::move(points), At(1),
                                                   At(2));
    }
    if (kind_ == "square_root") {
      std::vector<std::vector<double>> points;
      for (const py::handle& point : py::cast<py::sequence>(arguments_[0])) {
        points.push_back(Numbers(point));
      }
      bundle::LinearPrior::Root root{static_cast<int>(py::len(arguments_[2])), At(1), At(2)};
      return std::make_unique<bundle::LinearPrior>(head_, retractions_, std::move(points),
                                                   std::move(root));
    }
    if (kind_ == "imu") {
      const bool has_gravity = py::cast<bool>(arguments_[2]);
      return std::make_unique<bundle::ImuFactor>(
          head_, py::cast<std::shared_ptr<bundle::Preintegration>>(arguments_[0]), At(1),
          has_gravity ? &retractions_.at(5) : nullptr, py::cast<bool>(arguments_[3]));
    }
    if (kind_ == "image_imu") {
      return std::make_unique<bundle::ImageImuFactor>(
          head_, py::cast<std::shared_ptr<bundle::Preintegration>>(arguments_[0]), At(1), At(2));
    }
    if (kind_ == "function") {
      return std::make_unique<PythonFactor>(head_, retractions_, arguments_[0],
                                            py::cast<int>(arguments_[1]), start_);
    }
    throw bundle::InputError(head_.name + ": there is no factor of kind " + kind_);
  }

 private:
  std::vector<double> At(int argument) const { return Numbers(arguments_[argument]); }

  std::string kind_;
  py::tuple arguments_;
  bundle::FactorHead head_;
  std::vector<bundle::Retraction> retractions_;
  std::vector<const double*> start_;
};

}  // namespace

bundle::Block VariableFromPython(const py::tuple& given) {
  auto value = Numbers(given[2]);
  const auto name = py::cast<std::string>(given[0]);
  const auto retraction =
      bundle::RetractionFromName(py::cast<std::string>(given[1]), static_cast<int>(value.size()));
  value = bundle::CheckedValue(name, retraction, std::move(value));
  return {name,
          retraction,
          std::move(value),
          py::cast<std::vector<bool>>(given[3]),
          Numbers(given[4]),
          Numbers(given[5])};
}

bundle::FactorGraph GraphFromPython(const py::list& variables, const py::list& factors) {
  bundle::FactorGraph graph;
  for (const py::handle& variable : variables) {
    graph.blocks.push_back(VariableFromPython(py::cast<py::tuple>(variable)));
  }
  for (const py::handle& factor : factors) {
    graph.factors.push_back(FactorReader(py::cast<py::tuple>(factor), graph.blocks).Read());
  }
  return graph;
}
