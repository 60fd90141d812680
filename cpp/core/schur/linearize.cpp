/// Part of SchurProblem (schur_problem.h): linearisation, which is a pass over the points, sums
/// over ranks, and damping.
///
/// Newton decrements (minimize/sigma_rule.h) are nearly without damping. But a point whose depth is
/// less certain than the depth itself slides to infinity and back at no cost, and its linear model
/// does not show this. With angular noise a, its depth column has the squared norm 1 / (a depth)^2,
/// so that the damping a^2 is a prior that it stays within its own depth. a is 1e-3 to 1e-4; the
/// damping is a tenth of that, squared, because many points with uncertain depths together can
/// still determine what the cameras share.
///
/// The gradient's maximum norm is that of x - P(x - g). COLMAP's Ceres takes it in the numbers of a
/// quaternion q and not in those of a rotation vector, so that a rotation is at most 2. Its Plus
/// turns q from the left by twice its argument. So with the gradient a w.r.t. a rotation from the
/// left, the argument is -2 a and the turn is -4 a. A step dw turns by J_l dw: a = J_l^-T g.
///
/// Conjugate gradients amplify rounding errors. For them, sums are made on a grid
/// (schur/assembly/sum_grid.h). All other sums over points are double-doubles
/// (sums/double_double.h). Sums over factors other than observations are plain doubles and are
/// added last.

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/geometry/rotation.h"
#include "core/minimize/damping.h"
#include "core/model/camera_states.h"
#include "core/model/parameter_layout.h"
#include "core/schur/assembly/sum_systems.h"
#include "core/schur/for_chunks.h"
#include "core/schur/schur_problem.h"
#include "core/sums/communicator.h"

namespace bundle {
namespace {

constexpr double kPointDecrementDamping = 1e-9;

/// Holds all points of a plan constant during its lifetime. A pass then costs half, because no pair
/// of images contributes, and still returns the squared norms.
class HeldPoints {
 public:
  explicit HeldPoints(EliminationPlan* plan) : plan_(plan), num_free_(plan->num_free_points) {
    plan_->num_free_points = 0;
  }
  ~HeldPoints() { plan_->num_free_points = num_free_; }
  HeldPoints(const HeldPoints&) = delete;
  HeldPoints& operator=(const HeldPoints&) = delete;

 private:
  EliminationPlan* const plan_;
  const int num_free_;
};

/// Replaces the moves -g of each pose's w by the largest move of its quaternion.
void MoveQuaternions(const AdjustmentProblem& problem, const ParameterLayout& layout,
                     const CameraStates& cameras, std::vector<double>* moves) {
  for (int pose = 0; pose < NumPoses(problem); ++pose) {
    if (layout.pose_block(pose) < 0) continue;
    const CameraBlock& block = layout.blocks()[layout.pose_block(pose)];
    double* const first = moves->data() + block.offset;
    Eigen::Vector3d move = Eigen::Vector3d::Zero();
    int size = 0;
    for (; size < block.size && block.columns[size] < 3; ++size) {
      move[block.columns[size]] = first[size];
    }
    const double* const left_jacobian = cameras.pose(pose).left_jacobian;
    const Eigen::Vector3d turn =  // of column-major numbers, which are the transpose
        4 * (Eigen::Map<const Eigen::Matrix3d>(left_jacobian).inverse() * move);
    double value[7], increment[4], turned[4];
    cameras.ValueOf(pose, value);
    ExpQuaternion(turn.data(), increment);
    QuaternionProduct(increment, value, turned);
    double largest = 0;
    for (int i = 0; i < 4; ++i) {
      const double by = std::abs(turned[i] - value[i]);
      if (!(by <= largest)) largest = by;
    }
    std::fill_n(first, size, largest);
  }
}

}  // namespace

Linearization SchurProblem::Linearize(double damping) {
  const bool for_decrement = damping == kDecrementDamping;
  damping_ = for_decrement ? kPointDecrementDamping : damping;
  setup_.assembler.SetMaps(x_->cameras());
  const bool first = !scaled_;
  const double factors_cost = factors_.Linearize(x_->cameras(), x_->points.data());
  PointSums sums = SumUp(damping_, first, factors_cost);
  Linearization result;
  result.cost = x_cost_ = sums.cost;
  result.held_cost = x_held_cost_;
  point_decrement_ = sums.decrement;
  double gradient_squared = sums.gradient_squared, gradient_max = sums.gradient_max;
  HoldActive();
  DampCameras(damping, first);
  std::vector<double> moves(gradient().size());
  for (size_t j = 0; j < moves.size(); ++j) {
    const double g = gradient()[j];
    gradient_squared += g * g;
    moves[j] = ProjectedStep(j, -g);
  }
  if (moves_quaternions_) MoveQuaternions(problem_, layout_, x_->cameras(), &moves);
  for (const double move : moves) {
    if (!(std::abs(move) <= gradient_max)) gradient_max = std::abs(move);
  }
  result.gradient_norm = std::sqrt(gradient_squared);
  result.gradient_max_norm = gradient_max;
  result.is_finite = std::isfinite(result.cost) && std::isfinite(result.gradient_norm);
  scaled_ = true;
  return result;
}

SchurProblem::PointSums SchurProblem::SumUp(double damping, bool first, double factors_cost) {
  CameraSums& cameras = camera_sums();
  const auto pass = [&] {
    PointSums sums = SumChunks(damping, first, factors_cost);
    SumCameraVectors(communicator_, &sums_.sums());
    return sums;
  };
  if (grid_ == nullptr) {
    PointSums sums = pass();
    CameraSums& summed = sums_.sums();
    const Assembler& assembler = setup_.assembler_of_sums();
    SumSystems(communicator_, setup_.structure_of_sums(), assembler, &summed);
    assembler.Round(&pool_, &summed);
    if (setup_.part_sums != nullptr) {
      setup_.part_sums->Map(summed, solver_->NeedsCameraDiagonal(), &pool_, &cameras);
    }
    factors_.AddTo(&cameras);
    if (summed.has_error_terms || has_camera_factors_ || setup_.part_sums != nullptr)
      BroadcastCameraVectors(communicator_, &cameras);
    return sums;
  }
  if (grid_->is_chosen()) {
    grid_->Choose(observed_norms_, x_cost_);
  } else {
    const HeldPoints held(&setup_.plan);
    const double cost = pass().cost;
    grid_->Choose(cameras.squared_norms, cost);
  }
  PointSums sums = pass();
  if (!grid_->Fits(cameras.squared_norms, sums.cost)) {
    grid_->Choose(cameras.squared_norms, sums.cost);
    sums = pass();
  }
  observed_norms_ = cameras.squared_norms;
  SumSystems(communicator_, structure_, assembler_, &cameras);
  factors_.AddTo(&cameras);  // not on the grid, therefore added last
  if (has_camera_factors_) BroadcastCameraVectors(communicator_, &cameras);
  return sums;
}

SchurProblem::PointSums SchurProblem::SumChunks(double damping, bool first, double factors_cost) {
  sums_.Clear(&pool_);
  std::vector<ChunkSum> parts(plan_.chunks.size());
  ForChunks(
      [&](int c, int thread) {
        ThrowIfInterrupted();
        ChunkSum& sum = sums_.Begin(c, thread);
        StateRecords x = x_->records();
        if (first && plan_.chunks[c].first_row == 0) x.sink = x_->held.Collect(c);
        kernels_.eliminate(input_, x, plan_.chunks[c], damping, first, squared_scale_.data(),
                           Memory(thread), &sum);
        parts[c] = sum;
        sums_.End(thread);
      },
      [&](int thread) { sums_.Flush(thread); });
  ThrowIfInterrupted();  // only this thread sees the interrupt; the others may have taken all
                         // chunks
  DoubleDouble cost, gradient_squared, decrement;
  cost.Add(factors_cost);
  PointSums total;
  for (const ChunkSum& part : parts) {
    cost.Add(part.cost);
    gradient_squared.Add(part.gradient_squared);
    decrement.Add(part.decrement);
    if (!(part.gradient_max <= total.gradient_max)) total.gradient_max = part.gradient_max;
  }
  if (first) x_->held.Merge();
  DoubleDouble held_cost = x_->held.Cost(input_.loss, input_.loss_scale);
  RoundOverRanks(communicator_, {&cost, &gradient_squared, &decrement, &held_cost});
  total.cost = cost.sum;
  x_held_cost_ = held_cost.sum;
  total.gradient_squared = gradient_squared.sum;
  total.decrement = decrement.sum;
  total.gradient_max = MaxOverRanks(communicator_, total.gradient_max);
  return total;
}

void SchurProblem::DampCameras(double damping, bool first) {
  CameraSums& sums = camera_sums();
  for (size_t j = 0; j < scale_.size(); ++j) {
    const double squared_norm = sums.squared_norms[j];
    if (first) scale_[j] = JacobiScale(squared_norm);
    d_squared_[j] = SquaredDamping(squared_norm, scale_[j]);
  }
  assembler_.AddDamping(damping, d_squared_, &sums);
}

void SchurProblem::HoldActive() {
  if (!HasBounds()) return;
  active_.resize(gradient().size());
  for (size_t j = 0; j < active_.size(); ++j) {
    active_[j] = bounds_.IsActive(j, x_->camera_state[j], gradient()[j]);
  }
  assembler_.ClearColumns(active_, &camera_sums());
}

}  // namespace bundle
