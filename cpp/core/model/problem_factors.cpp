#include "core/model/problem_factors.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <typeinfo>
#include <utility>

#include "core/cameras/camera_model.h"
#include "core/factors/twist_tie.h"
#include "core/geometry/rotation.h"
#include "core/model/factor_costs.h"

namespace bundle {
namespace {

using Kind = ProblemVariable::Kind;

constexpr int kPoseNumbers = 7;  // numbers of a pose variable (image, frame or sensor)

const ProblemVariable& VariableOf(const Factor& factor, const AdjustmentProblem& problem,
                                  size_t place) {
  return problem.factors->variables[factor.blocks()[place]];
}

bool IsPose(Kind kind) {
  return kind == Kind::kImage || kind == Kind::kFrame || kind == Kind::kSensor;
}

/// The number of a pose variable (NumPoses).
int PoseNumber(Kind kind, int index, const AdjustmentProblem& problem) {
  if (kind == Kind::kImage) return index;
  return kind == Kind::kFrame ? PoseOfFrame(problem, index) : PoseOfSensor(problem, index);
}

/// A block of the layout with unknowns of a variable. is_of_rig: the unknowns are those of the
/// image's frame or sensor; rig_column: column of the first of these.
struct VariableBlock {
  int block;
  bool is_of_rig;
  int rig_column;
};

/// The blocks that have unknowns of a variable; empty for eliminated points.
std::vector<VariableBlock> BlocksOf(const ProblemVariable& variable,
                                    const AdjustmentProblem& problem,
                                    const ParameterLayout& layout) {
  std::vector<VariableBlock> blocks;
  const auto add = [&](int block, bool is_of_rig, int rig_column) {
    if (block >= 0) blocks.push_back({block, is_of_rig, rig_column});
  };
  if (variable.kind == Kind::kPoint) {
    add(layout.kept_block(variable.index), false, 0);
    return blocks;
  }
  if (variable.kind == Kind::kTwist) {
    add(layout.pose_block(variable.index), false, 0);
    return blocks;
  }
  if (variable.kind == Kind::kReadout) {
    add(layout.readout_block(variable.index), false, 0);
    return blocks;
  }
  if (variable.kind == Kind::kCamera) {
    add(layout.params_block(variable.index), false, 0);
    for (const TiedParameter& tie : layout.tied(variable.index)) {
      const auto is_it = [&](const VariableBlock& of) { return of.block == tie.block; };
      if (std::none_of(blocks.begin(), blocks.end(), is_it)) add(tie.block, false, 0);
    }
  } else if (variable.kind == Kind::kImage && problem.FrameOf(variable.index) >= 0) {
    const ParameterLayout::ImageBlocks& of = layout.blocks_of(variable.index);
    add(of[ParameterLayout::kPoseBlock], true, 0);
    add(of[ParameterLayout::kSensorBlock], true, kPoseSize);
  } else {
    add(layout.pose_block(PoseNumber(variable.kind, variable.index, problem)), false, 0);
  }
  return blocks;
}

/// The free columns of a variable in one of its blocks: for each, the unknown that moves it, and
/// its factor.
template <typename Visit>
void ForFreeColumns(const ProblemVariable& variable, const ParameterLayout& layout, int index,
                    const Visit& visit) {
  const CameraBlock& block = layout.blocks()[index];
  if (variable.kind == Kind::kReadout) {
    visit(0, 0, 1.0);
    return;
  }
  const bool is_camera = variable.kind == Kind::kCamera;
  const int first = variable.kind == Kind::kTwist ? kFirstTwist : is_camera ? kPoseSize : 0;
  const int last = is_camera ? kFirstTwist : IsPose(variable.kind) ? kPoseSize : kImageColumns;
  if (!is_camera || index == layout.params_block(variable.index)) {
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      if (column >= first && column < last) visit(k, column - first, 1.0);
    }
  }
  if (!is_camera) return;
  for (const TiedParameter& tie : layout.tied(variable.index)) {
    if (tie.block == index) visit(tie.entry, tie.column - kPoseSize, tie.scale);
  }
}

FactorUnknowns UnknownsOf(const Factor& factor, const AdjustmentProblem& problem,
                          const ParameterLayout& layout) {
  FactorUnknowns unknowns;
  for (size_t v = 0; v < factor.blocks().size(); ++v) {
    const ProblemVariable& variable = VariableOf(factor, problem, v);
    if (variable.kind == Kind::kPoint && layout.point_is_free(variable.index)) {
      unknowns.points.push_back(variable.index);
    }
    for (const VariableBlock& of : BlocksOf(variable, problem, layout)) {
      bool is_free = false;
      ForFreeColumns(variable, layout, of.block, [&](int, int, double) { is_free = true; });
      if (is_free) unknowns.blocks.push_back(of.block);
    }
  }
  std::vector<int>& blocks = unknowns.blocks;
  std::sort(blocks.begin(), blocks.end());
  blocks.erase(std::unique(blocks.begin(), blocks.end()), blocks.end());
  return unknowns;
}

}  // namespace

const double* ValueOf(const ProblemVariable& variable, const AdjustmentProblem& problem) {
  const int64_t index = variable.index;
  switch (variable.kind) {
    case Kind::kCamera:
      return problem.ParamsOf(variable.index);
    case Kind::kPoint:
      return problem.points + 3 * index;
    case Kind::kTwist:
      return problem.TwistOf(variable.index);
    case Kind::kReadout:
      return problem.readouts + index;
    default:
      return ValueOfPose(problem, PoseNumber(variable.kind, variable.index, problem));
  }
}

std::vector<FactorUnknowns> FindFactorUnknowns(const AdjustmentProblem& problem,
                                               const ParameterLayout& layout) {
  std::vector<FactorUnknowns> result;
  if (problem.factors == nullptr) return result;
  for (const auto& factor : problem.factors->factors) {
    result.push_back(UnknownsOf(*factor, problem, layout));
  }
  return result;
}

bool DependsOnPoses(const AdjustmentProblem& problem) {
  if (problem.factors == nullptr) return false;
  const auto& variables = problem.factors->variables;
  return std::any_of(variables.begin(), variables.end(), [](const ProblemVariable& variable) {
    return variable.kind != Kind::kCamera;
  });
}

bool MayFixGauge(const AdjustmentProblem& problem) {
  if (!DependsOnPoses(problem)) return false;
  const auto& factors = problem.factors->factors;
  return std::any_of(factors.begin(), factors.end(), [&](const std::unique_ptr<Factor>& factor) {
    if (dynamic_cast<const TwistTieFactor*>(factor.get()) != nullptr) return false;
    return std::any_of(factor->blocks().begin(), factor->blocks().end(), [&](int block) {
      return problem.factors->variables[block].kind != Kind::kCamera;
    });
  });
}

ChartedFactor::ChartedFactor(const Factor& factor, const AdjustmentProblem& problem,
                             const ParameterLayout& layout)
    : factor_(factor), problem_(problem), unknowns_(UnknownsOf(factor, problem, layout)) {
  for (size_t p = 0; p < unknowns_.points.size(); ++p) {
    column_begin_.push_back(num_columns_);
    num_columns_ += 3;
  }
  for (const int block : unknowns_.blocks) {
    column_begin_.push_back(num_columns_);
    num_columns_ += layout.blocks()[block].size;
  }
  column_begin_.push_back(num_columns_);
  int num_points = 0;
  for (size_t v = 0; v < factor.blocks().size(); ++v) {
    const ProblemVariable& given = VariableOf(factor, problem, v);
    Variable variable;
    variable.kind = given.kind;
    variable.index = given.index;
    if (given.kind == Kind::kPoint) {
      if (layout.point_is_free(given.index)) {
        variable.free_point = num_points;
        for (int j = 0; j < 3; ++j) {
          variable.columns.push_back(static_cast<int8_t>(j));
          variable.jacobian_column.push_back(column_begin_[num_points] + j);
          variable.scale.push_back(1.0);
        }
        ++num_points;
      }
    }
    for (const VariableBlock& of : BlocksOf(given, problem, layout)) {
      const auto& blocks = unknowns_.blocks;
      const auto place = std::lower_bound(blocks.begin(), blocks.end(), of.block) - blocks.begin();
      ForFreeColumns(given, layout, of.block, [&](int k, int column, double scale) {
        auto& columns = of.is_of_rig ? variable.rig_columns : variable.columns;
        auto& to = of.is_of_rig ? variable.rig_jacobian_column : variable.jacobian_column;
        columns.push_back(static_cast<int8_t>(of.rig_column + column));
        to.push_back(column_begin_[unknowns_.points.size() + place] + k);
        if (!of.is_of_rig) variable.scale.push_back(scale);
      });
    }
    variables_.push_back(std::move(variable));
  }
}

namespace {

/// Converts a row by (phi, rho) to one by (w, t), as derived in the header.
void ToChart(const PoseState& pose, const double* origin, const double* row, double* out) {
  double a[3], turned[3];
  Cross3(row + 3, origin, a);
  for (int j = 0; j < 3; ++j) a[j] += row[j];
  MatrixVector3(pose.rotation, a, turned);
  VectorMatrix3(turned, pose.left_jacobian, out);
  MatrixVector3(pose.rotation, row + 3, out + 3);
}

/// For an image that turns about its centre: adds the effect of w on t.
void AddTurn(const PoseState& pose, double* by_chart) {
  double by_turn[9], moved[3];
  MinusCross(pose.translation, pose.left_jacobian, by_turn);
  VectorMatrix3(by_chart + 3, by_turn, moved);
  for (int j = 0; j < 3; ++j) by_chart[j] += moved[j];
}

/// The value of a pose variable at a state, in the world of the factors.
void PoseOf(const CameraStates& cameras, int pose, const double* origin, double* value) {
  cameras.ValueOf(pose, value);
  NormalizeQuaternion(value);
  double moved[3];
  MatrixVector3(cameras.pose(pose).rotation, origin, moved);
  for (int j = 0; j < 3; ++j) value[4 + j] -= moved[j];
}

/// Converts a row by local coordinates of an image to rows by its frame's chart and its sensor's.
void ToRig(const RigPose& rig, const double* row, double* out) {
  double map[36];
  FrameMap(rig, map);
  RowTimesMap(row, map, out);
  if (rig.sensor == nullptr) return;
  SensorMap(rig, map);
  RowTimesMap(row, map, out + kPoseSize);
}

constexpr double kNoOrigin[3] = {};

}  // namespace

double ChartedFactor::Cost(const CameraStates& cameras, const double* const* points) const {
  std::vector<double> residual(num_residuals());
  const bool has_value = Evaluate(cameras, points, residual.data(), nullptr);
  return has_value ? ApplyLoss(factor_, 0, residual.data(), nullptr)
                   : std::numeric_limits<double>::quiet_NaN();
}

bool ChartedFactor::Evaluate(const CameraStates& cameras, const double* const* points,
                             double* residual, double* jacobian) const {
  const int rows = num_residuals();
  const size_t count = variables_.size();
  std::vector<const double*> values(count);
  std::vector<double*> jacobians(count, nullptr);
  // Values of images and points, then the Jacobians by the variables' own coordinates.
  size_t num_doubles = kPoseNumbers * count;
  for (size_t v = 0; v < count && jacobian != nullptr; ++v) {
    num_doubles += static_cast<size_t>(rows) * factor_.retractions()[v].tangent_size();
  }
  std::vector<double> doubles(num_doubles);
  double* next = doubles.data() + kPoseNumbers * count;
  for (size_t v = 0; v < count; ++v) {
    const Variable& variable = variables_[v];
    double* const value = doubles.data() + kPoseNumbers * v;
    values[v] = value;
    if (IsPose(variable.kind)) {
      PoseOf(cameras, PoseNumber(variable.kind, variable.index, problem_),
             variable.kind == Kind::kSensor ? kNoOrigin : problem_.origin, value);
    } else if (variable.kind == Kind::kCamera) {
      values[v] = cameras.params(variable.index);
    } else if (variable.kind == Kind::kTwist) {
      values[v] = cameras.twist(variable.index);
    } else if (variable.kind == Kind::kReadout) {
      values[v] = cameras.readout(variable.index);
    } else {
      const double* const point = variable.free_point >= 0
                                      ? points[variable.free_point]
                                      : problem_.points + 3 * int64_t{variable.index};
      for (int j = 0; j < 3; ++j) value[j] = point[j] + problem_.origin[j];
    }
    if (jacobian == nullptr || !variable.is_free()) continue;
    jacobians[v] = next;
    next += static_cast<size_t>(rows) * factor_.retractions()[v].tangent_size();
  }
  if (!factor_.Evaluate(values.data(), residual, jacobian != nullptr ? jacobians.data() : nullptr))
    return false;
  if (!std::all_of(residual, residual + rows, [](double r) { return std::isfinite(r); })) {
    return false;
  }
  if (jacobian == nullptr) return true;
  std::fill(jacobian, jacobian + static_cast<size_t>(rows) * num_columns_, 0.0);
  for (size_t v = 0; v < count; ++v) {
    const Variable& variable = variables_[v];
    if (jacobians[v] == nullptr) continue;
    const int width = factor_.retractions()[v].tangent_size();
    for (int r = 0; r < rows; ++r) {
      const double* row = jacobians[v] + static_cast<size_t>(r) * width;
      double* const out = jacobian + static_cast<size_t>(r) * num_columns_;
      double by_chart[kPoseSize], by_rig[2 * kPoseSize];
      if (IsPose(variable.kind)) {
        ToChart(cameras.pose(PoseNumber(variable.kind, variable.index, problem_)),
                variable.kind == Kind::kSensor ? kNoOrigin : problem_.origin, row, by_chart);
        if (variable.kind == Kind::kImage && TurnsAboutCentre(problem_, variable.index)) {
          AddTurn(cameras.pose(variable.index), by_chart);
        }
        row = by_chart;
      }
      if (!variable.rig_columns.empty()) {
        ToRig(cameras.rig(variable.index), row, by_rig);
        for (size_t k = 0; k < variable.rig_columns.size(); ++k) {
          out[variable.rig_jacobian_column[k]] += by_rig[variable.rig_columns[k]];
        }
      }
      for (size_t k = 0; k < variable.columns.size(); ++k) {
        out[variable.jacobian_column[k]] += variable.scale[k] * row[variable.columns[k]];
      }
    }
  }
  return true;
}

}  // namespace bundle
