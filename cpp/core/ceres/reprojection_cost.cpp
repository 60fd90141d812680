#include "core/ceres/reprojection_cost.h"

#include <algorithm>
#include <cstddef>
#include <utility>
#include <vector>

#include "core/factors/reprojection.h"

namespace bundle {
namespace {

class ReprojectionCost final : public ceres::CostFunction {
 public:
  ReprojectionCost(const ReprojectionContext& context, int64_t observation) : context_(context) {
    const AdjustmentProblem& problem = context.problem;
    const ParameterLayout& layout = context.layout;
    const int point = problem.observation_point[observation];
    image_ = problem.observation_image[observation];
    const int camera = problem.image_camera[image_];
    model_ = problem.camera_models[camera];
    pose_ = &context.states.pose(image_);
    shutter_ = context.states.shutter(image_);
    params_ = context.states.params(camera);
    measurement_ = problem.observation_xy + 2 * observation;

    set_num_residuals(2);
    if (layout.point_is_free(point)) {
      mutable_parameter_block_sizes()->push_back(3);
    } else {
      fixed_point_ = problem.points + 3 * static_cast<int64_t>(point);
    }
    const ParameterLayout::ImageBlocks& of = layout.blocks_of(image_);
    for (int place = 0; place < static_cast<int>(of.size()); ++place) {
      const int index = of[place];
      if (index < 0) continue;
      const CameraBlock& block = layout.blocks()[index];
      has_map_[num_blocks_] = layout.HasMap(problem, image_, place);
      place_[num_blocks_] = static_cast<int8_t>(place);
      blocks_[num_blocks_++] = &block;
      mutable_parameter_block_sizes()->push_back(block.size);
    }
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const std::atomic<bool>* const abandoned = context_.abandoned;
    if (abandoned != nullptr && abandoned->load(std::memory_order_relaxed)) return false;
    const double* point = fixed_point_ != nullptr ? fixed_point_ : parameters[0];
    if (jacobians == nullptr) {
      const bool in_front = EvaluateReprojection(*model_, *pose_, params_, point, measurement_,
                                                 context_.cheirality, residuals, nullptr, shutter_);
      if (context_.watch != nullptr) AtCandidate(in_front, residuals);
      return true;
    }
    ReprojectionJacobian jacobian;
    const bool in_front = EvaluateReprojection(*model_, *pose_, params_, point, measurement_,
                                               context_.cheirality, residuals, &jacobian, shutter_);
    if (context_.watch != nullptr) AtStateOrCandidate(in_front, residuals, &jacobian);
    if (fixed_point_ == nullptr) {
      if (jacobians[0] != nullptr) std::copy_n(jacobian.point, 6, jacobians[0]);
      ++jacobians;
    }
    const RigPose rig = context_.states.rig(image_);
    double local[2 * kPoseSize];
    if (rig.frame != nullptr) std::copy_n(jacobian.pose, 2 * kPoseSize, local);
    for (int b = 0; b < num_blocks_; ++b) {
      if (jacobians[b] == nullptr) continue;
      const bool is_sensor = place_[b] == ParameterLayout::kSensorBlock;
      const bool is_pose = is_sensor || place_[b] == ParameterLayout::kPoseBlock;
      if (rig.frame != nullptr && is_pose) ChainRig(rig, local, is_sensor, jacobian.pose);
      if (has_map_[b]) {
        GatherMapped(jacobian, place_[b], *blocks_[b], jacobians[b]);
      } else {
        Gather(jacobian, *blocks_[b], jacobians[b]);
      }
    }
    return true;
  }

 private:
  void AtCandidate(bool in_front, double* residual) const {
    const bool counts = CountsAfterState(in_front, residual);
    if (!counts) {
      std::copy_n(held_, 2, residual);
      AddHeld(&context_.watch->candidate_cost);
    }
    if (counts != counted_) context_.watch->has_changed.store(true, std::memory_order_relaxed);
  }

  void AtStateOrCandidate(bool in_front, double* residual, ReprojectionJacobian* jacobian) const {
    const bool counts = context_.watch->is_at_start.load(std::memory_order_relaxed)
                            ? in_front
                            : CountsAfterState(in_front, residual);
    if (context_.watch->is_at_candidate.load(std::memory_order_relaxed)) {
      if (counts) return;
      Hold(residual, jacobian);
      AddHeld(&context_.watch->candidate_cost);
      return;
    }
    if (counts != counted_) context_.watch->num_held.fetch_add(counts ? -1 : 1);
    counted_ = counts;
    if (counts) {
      for (int i = 0; i < 2; ++i) held_[i] = kHeldFactor * residual[i];
    } else {
      AddHeld(in_front ? residual : held_, &context_.watch->cost_if_all_count);
      Hold(residual, jacobian);
      AddHeld(&context_.watch->state_cost);
    }
  }

  void AddHeld(std::atomic<double>* cost) const { AddHeld(held_, cost); }

  void AddHeld(const double* residual, std::atomic<double>* cost) const {
    const double* const sigmas = context_.problem.observation_sigma;
    const double sigma =
        sigmas == nullptr ? 1 : sigmas[(measurement_ - context_.problem.observation_xy) / 2];
    context_.watch->AddHeld(
        (residual[0] * residual[0] + residual[1] * residual[1]) / (sigma * sigma), cost);
  }

  void Hold(double* residual, ReprojectionJacobian* jacobian) const {
    std::copy_n(held_, 2, residual);
    *jacobian = {};
  }

  bool CountsAfterState(bool in_front, const double* r) const {
    if (!in_front || counted_) return in_front;
    return r[0] * r[0] + r[1] * r[1] <= held_[0] * held_[0] + held_[1] * held_[1];
  }

  static void ChainRig(const RigPose& rig, const double* local, bool is_sensor, double* out) {
    double map[kPoseSize * kPoseSize];
    is_sensor ? SensorMap(rig, map) : FrameMap(rig, map);
    for (int row = 0; row < 2; ++row) {
      RowTimesMap(local + kPoseSize * row, map, out + kPoseSize * row);
    }
  }

  void GatherMapped(const ReprojectionJacobian& jacobian, int place, const CameraBlock& block,
                    double* out) const {
    ColumnMap map;
    context_.layout.FillMap(context_.problem, image_, place, *pose_,
                            context_.states.twist_map(image_), &map);
    std::fill_n(out, 2 * block.size, 0.0);
    for (int i = 0; i < map.num_columns; ++i) {
      const double* const row = map.values + i * block.size;
      AddMultiple(*EntryOf(jacobian, 0, map.columns[i]), row, block.size, out);
      AddMultiple(*EntryOf(jacobian, 1, map.columns[i]), row, block.size, out + block.size);
    }
  }

  const double* EntryOf(const ReprojectionJacobian& jacobian, int row, int column) const {
    if (column < kPoseSize) return jacobian.pose + kPoseSize * row + column;
    if (column < kFirstTwist) {
      return jacobian.params + model_->num_params * row + (column - kPoseSize);
    }
    return jacobian.twist + kTwistSize * row + (column - kFirstTwist);
  }

  static void AddMultiple(double factor, const double* from, int size, double* to) {
    for (int k = 0; k < size; ++k) to[k] += factor * from[k];
  }

  void Gather(const ReprojectionJacobian& jacobian, const CameraBlock& block, double* out) const {
    for (int k = 0; k < block.size; ++k) {
      for (int row = 0; row < 2; ++row) {
        out[row * block.size + k] = *EntryOf(jacobian, row, block.columns[k]);
      }
    }
  }

  const ReprojectionContext& context_;
  const CameraModel* model_;
  const PoseState* pose_;
  const ImageShutter* shutter_;
  const double* params_;
  const double* fixed_point_ = nullptr;
  const double* measurement_;
  const CameraBlock* blocks_[ParameterLayout::kNumPlaces] = {};
  mutable double held_[2] = {0, 0};  ///< residual while the observation does not count
  int image_;
  int8_t num_blocks_ = 0;
  int8_t place_[ParameterLayout::kNumPlaces] = {};  ///< per block: its place in ImageBlocks
  bool has_map_[ParameterLayout::kNumPlaces] = {};  ///< per block
  mutable bool counted_ = true;                     ///< at the last state
};

/// A reprojection cost divided by the observation's sigma. The held residual is stored in pixels by
/// the inner cost, and only compared with that observation's own residual.
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
  std::unique_ptr<ceres::CostFunction> cost =
      std::make_unique<ReprojectionCost>(context, observation);
  const double* const sigmas = context.problem.observation_sigma;
  if (sigmas == nullptr) return cost;
  return std::make_unique<DividedBySigma>(std::move(cost), sigmas[observation]);
}

}  // namespace bundle
