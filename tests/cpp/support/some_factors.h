#pragma once

/// Factors of each kind for a scene: seeded, near its values, of about the weight of a pixel.

#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "core/factors/attitude_factors.h"
#include "core/factors/linear_prior.h"
#include "core/factors/measurement_factors.h"
#include "core/model/problem_factors.h"
#include "support/scene.h"

namespace bundle::testing {

using Kind = ProblemVariable::Kind;

inline Scene SmallScene(int images_per_camera) {
  SceneOptions options;
  options.num_images = 4;
  options.num_points = 14;
  options.track_length = 3;
  options.images_per_camera = images_per_camera;
  return MakeScene(options);
}

class FactorMaker {
 public:
  explicit FactorMaker(const Scene& scene) : problem_(scene.View()) {}

  ProblemFactors Take() { return std::move(made_); }

  void Prior(Kind kind, int index, LossType loss) {
    const Retraction retraction = RetractionOf(kind, index);
    const FactorHead head = Head({{kind, index}}, loss);
    made_.factors.push_back(std::make_unique<PriorFactor>(
        head, retraction, Moved(kind, index), Information(retraction.tangent_size(), kind)));
  }

  /// Factor of a focal length.
  void Scalar(int camera, LossType loss) {
    const double value = 1.01 * problem_.ParamsOf(camera)[0];
    made_.factors.push_back(std::make_unique<ScalarPriorFactor>(
        Head({{Kind::kCamera, camera}}, loss), RetractionOf(Kind::kCamera, camera), 0, value, 0.02,
        /*relative=*/true));
  }

  void Position(int image, LossType loss) {
    made_.factors.push_back(std::make_unique<PositionFactor>(
        Head({{Kind::kImage, image}}, loss), std::vector<double>{0.3, -0.2, 1.1},
        std::vector<double>{0.1, 0.05, -0.2}, Information(3, Kind::kImage)));
  }

  /// Gravity, orientation and heading.
  void Attitudes(int image, LossType loss) {
    const std::vector<std::pair<Kind, int>> of = {{Kind::kImage, image}};
    made_.factors.push_back(std::make_unique<DirectionFactor>(
        Head(of, loss), std::vector<double>{0.1, 2, 0.3}, std::vector<double>{0, 0, -1}, 0.05));
    made_.factors.push_back(std::make_unique<RotationFactor>(
        Head(of, loss), std::vector<double>{0.1, 0.2, 0.1, 1}, Information(3, Kind::kImage)));
    made_.factors.push_back(std::make_unique<HeadingFactor>(
        Head(of, loss), std::vector<double>{1, 0.4, 0.2}, 0.7, 0.05));
  }

  void Between(Kind kind, int a, int b, LossType loss) {
    const Retraction retraction = RetractionOf(kind, a);
    const std::vector<double> x = Moved(kind, a), y = Moved(kind, b);
    std::vector<double> between(x.size());
    retraction.Between(x.data(), y.data(), between.data());
    made_.factors.push_back(
        std::make_unique<BetweenFactor>(Head({{kind, a}, {kind, b}}, loss), retraction, between,
                                        Information(retraction.tangent_size(), kind)));
  }

  void RelativePose(int a, int b, LossType loss) {
    made_.factors.push_back(std::make_unique<RelativePoseFactor>(
        Head({{Kind::kImage, a}, {Kind::kImage, b}}, loss),
        std::vector<double>{0.1, 0.2, 0, 1, 0.3, 0, 0.1}, Information(6, Kind::kImage)));
  }

  /// Factor of an image, a camera and another image.
  void Linear(int image, int camera, int other, LossType loss) {
    const std::vector<std::pair<Kind, int>> of = {
        {Kind::kImage, image}, {Kind::kCamera, camera}, {Kind::kImage, other}};
    std::vector<Retraction> retractions;
    std::vector<std::vector<double>> points;
    int n = 0;
    for (const auto& [kind, index] : of) {
      retractions.push_back(RetractionOf(kind, index));
      points.push_back(Moved(kind, index));
      n += retractions.back().tangent_size();
    }
    std::vector<double> lambda = Information(n, Kind::kImage), eta(n);
    for (double& value : eta) value = normal_(random_);
    made_.factors.push_back(
        std::make_unique<LinearPrior>(Head(of, loss), retractions, points, lambda, eta));
  }

  /// One of each.
  void AddAll(LossType loss, int num_cameras) {
    Prior(Kind::kImage, 1, loss);
    Position(0, loss);
    Position(2, loss);
    Attitudes(2, loss);
    Between(Kind::kImage, 0, 3, loss);
    Between(Kind::kImage, 2, 1, loss);
    RelativePose(1, 3, loss);
    Prior(Kind::kCamera, num_cameras - 1, loss);
    if (num_cameras > 1) Between(Kind::kCamera, 1, 0, loss);
    Linear(3, 0, 1, loss);
    Scalar(0, loss);
    for (const int point : {0, 5, 5, 9}) Prior(Kind::kPoint, point, loss);
  }

 private:
  FactorHead Head(const std::vector<std::pair<Kind, int>>& of, LossType loss) {
    FactorHead head;
    head.name = "factor " + std::to_string(made_.factors.size());
    for (const auto& [kind, index] : of) {
      head.blocks.push_back(static_cast<int>(made_.variables.size()));
      made_.variables.push_back({kind, index});
    }
    head.loss = loss;
    head.loss_scale = 2;
    return head;
  }

  Retraction RetractionOf(Kind kind, int index) const {
    if (kind == Kind::kImage) return Retraction(Manifold::kSe3, 7);
    const int size = kind == Kind::kPoint ? 3 : problem_.camera_models[index]->num_params;
    return Retraction(Manifold::kEuclidean, size);
  }

  /// A value of the variable's own, a little away.
  std::vector<double> Moved(Kind kind, int index) {
    const Retraction retraction = RetractionOf(kind, index);
    const int64_t i = index;
    const double* from = kind == Kind::kImage    ? problem_.cam_from_world + 7 * i
                         : kind == Kind::kCamera ? problem_.ParamsOf(index)
                                                 : problem_.points + 3 * i;
    std::vector<double> delta(retraction.tangent_size()), value(retraction.ambient_size());
    for (double& d : delta) d = 0.05 * normal_(random_);
    retraction.Plus(from, delta.data(), value.data());
    return value;
  }

  /// Symmetric, positive definite, full.
  std::vector<double> Information(int n, Kind kind) {
    const double scale = kind == Kind::kCamera ? 1 : 300;
    std::vector<double> root(static_cast<size_t>(n) * n), product(root.size());
    for (double& value : root) value = 0.3 * normal_(random_);
    for (int i = 0; i < n; ++i) root[i * n + i] += 1;
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        for (int k = 0; k < n; ++k) product[i * n + j] += scale * root[i * n + k] * root[j * n + k];
      }
    }
    return product;
  }

  AdjustmentProblem problem_;
  ProblemFactors made_;
  std::mt19937 random_{7};
  std::normal_distribution<double> normal_;
};

}  // namespace bundle::testing
