#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

#include "core/cameras/registry.h"
#include "core/ceres/cost_functions.h"
#include "core/factors/reprojection.h"

namespace bundle {
namespace {

template <typename Model>
class ReprojectionCost final : public ceres::CostFunction {
 public:
  ReprojectionCost(const ReprojectionContext& context, int64_t observation) {
    const ProblemView& problem = context.problem;
    const ParameterLayout& layout = context.layout;
    const int image = problem.observation_image[observation];
    const int camera = problem.image_camera[image];
    const int point = problem.observation_point[observation];
    pose_ = &context.states.pose(image);
    rig_ = context.states.rig(image);
    params_ = context.states.params(camera);
    cheirality_ = context.cheirality;
    abandoned_ = context.abandoned;
    watch_ = context.watch;
    measurement_ = problem.observation_xy + 2 * observation;

    context_ = &context;
    image_ = image;

    set_num_residuals(2);
    if (layout.point_is_free(point)) {
      mutable_parameter_block_sizes()->push_back(3);
    } else {
      fixed_point_ = problem.points + 3 * static_cast<int64_t>(point);
    }
    const ParameterLayout::ImageBlocks& of = layout.blocks_of(image);
    for (int place = 0; place < static_cast<int>(of.size()); ++place) {
      const int index = of[place];
      if (index < 0) continue;
      const CameraBlock& block = layout.blocks()[index];
      if (layout.HasMap(problem, image, place)) maps_of_[num_blocks_] = static_cast<int8_t>(place);
      if (index == layout.blocks_of(image)[ParameterLayout::kSensorBlock]) sensor_ = num_blocks_;
      blocks_[num_blocks_++] = &block;
      mutable_parameter_block_sizes()->push_back(block.size);
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (abandoned_ != nullptr && abandoned_->load(std::memory_order_relaxed)) return false;
    const double* point = fixed_point_ != nullptr ? fixed_point_ : parameters[0];
    if (jacobians == nullptr) {
      const bool in_front = EvaluateReprojection<Model, kParams>(
          *pose_, params_, point, measurement_, cheirality_, residuals, nullptr);
      if (watch_ != nullptr) AtCandidate(in_front, residuals);
      return true;
    }
    ReprojectionJacobian<kParams> jacobian;
    const bool in_front = EvaluateReprojection<Model>(*pose_, params_, point, measurement_,
                                                      cheirality_, residuals, &jacobian);
    if (watch_ != nullptr) AtStateOrCandidate(in_front, residuals, &jacobian);
    if (fixed_point_ == nullptr) {
      if (jacobians[0] != nullptr) std::copy_n(jacobian.point, 6, jacobians[0]);
      ++jacobians;
    }
    double local[2 * kPoseSize];
    if (rig_.frame != nullptr) std::copy_n(jacobian.pose, 2 * kPoseSize, local);
    for (int b = 0; b < num_blocks_; ++b) {
      if (jacobians[b] == nullptr) continue;
      if (rig_.frame != nullptr) ChainRig(local, b == sensor_, jacobian.pose);
      if (maps_of_[b] >= 0) {
        GatherMapped(jacobian, maps_of_[b], *blocks_[b], jacobians[b]);
      } else {
        Gather(jacobian, *blocks_[b], jacobians[b]);
      }
    }
    return true;
  }

 private:
  static constexpr int kParams = kNumParams<Model>;

  void AtCandidate(bool in_front, double* residual) const {
    const bool counts = CountsAfterState(in_front, residual);
    if (!counts) std::copy_n(held_, 2, residual);
    if (counts != counted_) watch_->has_changed.store(true, std::memory_order_relaxed);
  }

  void AtStateOrCandidate(bool in_front, double* residual,
                          ReprojectionJacobian<kParams>* jacobian) const {
    const bool counts = CountsAfterState(in_front, residual);
    if (watch_->is_at_candidate.load(std::memory_order_relaxed)) {
      if (!counts) Hold(residual, jacobian);
      return;
    }
    if (counts != counted_) watch_->num_held.fetch_add(counts ? -1 : 1);
    counted_ = counts;
    if (counts) {
      for (int i = 0; i < 2; ++i) held_[i] = kHeldFactor * residual[i];
    } else {
      Hold(residual, jacobian);
    }
  }

  void Hold(double* residual, ReprojectionJacobian<kParams>* jacobian) const {
    std::copy_n(held_, 2, residual);
    *jacobian = {};
  }

  bool CountsAfterState(bool in_front, const double* r) const {
    if (!in_front || counted_) return in_front;
    return r[0] * r[0] + r[1] * r[1] <= held_[0] * held_[0] + held_[1] * held_[1];
  }

  void ChainRig(const double* local, bool is_sensor, double* out) const {
    double map[kPoseSize * kPoseSize];
    is_sensor ? SensorMap(rig_, map) : FrameMap(rig_, map);
    std::fill_n(out, 2 * kPoseSize, 0.0);
    for (int row = 0; row < 2; ++row) {
      for (int i = 0; i < kPoseSize; ++i) {
        for (int j = 0; j < kPoseSize; ++j) {
          out[kPoseSize * row + j] += local[kPoseSize * row + i] * map[kPoseSize * i + j];
        }
      }
    }
  }

  void GatherMapped(const ReprojectionJacobian<kParams>& jacobian, int place,
                    const CameraBlock& block, double* out) const {
    ColumnMap map;
    context_->layout.FillMap(context_->problem, image_, place, *pose_, &map);
    std::fill_n(out, 2 * block.size, 0.0);
    for (int i = 0; i < map.num_columns; ++i) {
      const int column = map.columns[i];
      const bool is_pose = column < kPoseSize;
      const double* x = is_pose ? jacobian.pose + column : jacobian.params + (column - kPoseSize);
      const double* const row = map.values + i * block.size;
      AddMultiple(x[0], row, block.size, out);
      AddMultiple(x[is_pose ? kPoseSize : kParams], row, block.size, out + block.size);
    }
  }

  static void AddMultiple(double factor, const double* from, int size, double* to) {
    for (int k = 0; k < size; ++k) to[k] += factor * from[k];
  }

  static void Gather(const ReprojectionJacobian<kParams>& jacobian, const CameraBlock& block,
                     double* out) {
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      const bool is_pose = column < kPoseSize;
      const double* x = is_pose ? jacobian.pose + column : jacobian.params + (column - kPoseSize);
      out[k] = x[0];
      out[block.size + k] = x[is_pose ? kPoseSize : kParams];
    }
  }

  const PoseState* pose_;
  const double* params_;
  const double* fixed_point_ = nullptr;
  const double* measurement_;
  const ReprojectionContext* context_ = nullptr;
  const CameraBlock* blocks_[4] = {};
  HoldingWatch* watch_;
  mutable double held_[2] = {0, 0};  ///< what is held if the observation stops counting, or is held
  RigPose rig_;
  int image_ = -1;
  int8_t num_blocks_ = 0;
  int8_t maps_of_[4] = {-1, -1, -1, -1};  ///< of each block with a map: its place in ImageBlocks
  int8_t sensor_ = -1;                    ///< which of the blocks is the sensor's
  mutable bool counted_ = true;           ///< at the last state
  Cheirality cheirality_;
  const std::atomic<bool>* abandoned_ = nullptr;
};

/// A reprojection cost divided by the observation's sigma. What an observation holds is in pixels
/// below this, and compared with nothing but its own residual.
class DividedBySigma final : public ceres::CostFunction {
 public:
  DividedBySigma(std::unique_ptr<ceres::CostFunction> pixels, double sigma)
      : pixels_(std::move(pixels)), weight_(1 / sigma) {
    set_num_residuals(pixels_->num_residuals());
    *mutable_parameter_block_sizes() = pixels_->parameter_block_sizes();
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    if (!pixels_->Evaluate(parameters, residuals, jacobians)) return false;
    Scale(num_residuals(), residuals);
    const std::vector<int>& sizes = parameter_block_sizes();
    for (size_t b = 0; jacobians != nullptr && b < sizes.size(); ++b) {
      if (jacobians[b] != nullptr) Scale(num_residuals() * sizes[b], jacobians[b]);
    }
    return true;
  }

 private:
  void Scale(int size, double* values) const {
    for (int i = 0; i < size; ++i) values[i] *= weight_;
  }

  const std::unique_ptr<ceres::CostFunction> pixels_;
  const double weight_;
};

}  // namespace

std::unique_ptr<ceres::CostFunction> MakeReprojectionCost(const ReprojectionContext& context,
                                                          int64_t observation) {
  const ProblemView& problem = context.problem;
  const int camera = problem.image_camera[problem.observation_image[observation]];
  std::unique_ptr<ceres::CostFunction> cost;
  VisitCameraModel(*problem.camera_models[camera], [&](auto model) {
    cost = std::make_unique<ReprojectionCost<decltype(model)>>(context, observation);
  });
  if (problem.observation_sigma == nullptr) return cost;
  return std::make_unique<DividedBySigma>(std::move(cost), problem.observation_sigma[observation]);
}

}  // namespace bundle
