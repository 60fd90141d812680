#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/linear/supernodes.h"
#include "core/model/coupled_blocks.h"
#include "core/prepare/prepare.h"
#include "core/schur/schur_problem.h"
#include "schur/capturing_solver.h"
#include "support/normal_equations.h"
#include "support/scene.h"

namespace bundle {

using testing::Damping;
using testing::EliminatedEquations;
using testing::LinearizedProblem;
using testing::Real;
using testing::RealVector;
using testing::Scene;

/// A dense S, or a sparse one within its factor.
inline BlockStructure Structure(const AdjustmentProblem& problem, const ParameterLayout& layout,
                                bool dense) {
  std::vector<int> sizes;
  for (const CameraBlock& block : layout.blocks()) sizes.push_back(block.size);
  if (dense) return DenseStructure(sizes);
  const BlockStructure sparse = SparseStructure(sizes, FindCoupledBlocks(problem, layout));
  return PlaceInFactor(sparse, FindSupernodes(sparse));
}

/// Start of a solve; unless `natural`, with the blocks in another order.
inline PreparedSolve Prepare(const AdjustmentProblem& problem, const SolveOptions& options,
                             bool natural) {
  PreparedSolve prepared = PrepareSolve(problem, options);
  if (natural) return prepared;
  std::vector<int> order(prepared.layout.blocks().size());
  std::iota(order.begin(), order.end(), 0);
  std::shuffle(order.begin(), order.end(), std::mt19937(4));
  prepared.layout.Reorder(order);
  return prepared;
}

inline void ExpectNear(double found, Real expected, Real tolerance, const char* what) {
  EXPECT_NEAR(found, static_cast<double>(expected), static_cast<double>(tolerance)) << what;
}

/// A SchurProblem next to the same in extended precision.
class Comparison {
 public:
  Comparison(const Scene& scene, const SolveOptions& options, bool dense = true,
             const ProblemFactors* factors = nullptr)
      : problem_(WithFactors(scene.View(), factors)),
        options_(options),
        prepared_(Prepare(problem_, options, dense)),
        solver_(Structure(problem_, layout(), dense)),
        schur_(problem_, layout(), options, Structure(problem_, layout(), dense), &solver_),
        first_(problem_, layout(), options, CameraStates(problem_, layout()),
               LargeVector<double>(scene.points.begin(), scene.points.end())),
        damping_(first_) {}

  const ParameterLayout& layout() const { return prepared_.layout; }

  /// Linearises at the state that the problem is in, and compares all that comes of it.
  void Check(double damping) {
    const LinearizedProblem expected(problem_, layout(), options_, schur_.cameras(),
                                     schur_.Points());
    const RealVector d_squared = damping_.SquaredD(expected);
    const EliminatedEquations equations(expected, d_squared, damping);
    const Linearization found = schur_.Linearize(damping);
    ASSERT_EQ(schur_.SolveNewton(0.1).status, LinearStatus::kSuccess);
    CheckLinearization(found, expected);
    CheckSystem(equations, expected);
    const RealVector q = equations.Solve();
    const RealVector p = expected.gradient.cwiseQuotient(d_squared);
    CheckNewtonCandidate(expected, q);
    CheckProducts(expected, d_squared, p, q);
    CheckCombination(expected, p, q);
  }

  /// Goes to the candidate of the last Newton direction.
  void Step() {
    const Candidate candidate = schur_.EvaluateNewtonStep();
    schur_.Accept();
    const LinearizedProblem there(problem_, layout(), options_, schur_.cameras(), schur_.Points());
    ExpectNear(candidate.cost, there.cost, 1e-11L * there.cost, "cost of the candidate");
    ExpectNear(schur_.StateNorm(), StateNorm(), 1e-13L * StateNorm(), "norm of the state");
  }

 private:
  static AdjustmentProblem WithFactors(AdjustmentProblem problem, const ProblemFactors* factors) {
    problem.factors = factors;
    return problem;
  }

  void CheckLinearization(const Linearization& found, const LinearizedProblem& expected) const {
    EXPECT_TRUE(found.is_finite);
    EXPECT_EQ(schur_.num_active_observations(), expected.num_active);
    ExpectNear(found.cost, expected.cost, 1e-13L * expected.cost, "cost");
    ExpectNear(schur_.fixed_cost(), expected.fixed_cost, 1e-13L * expected.fixed_cost,
               "fixed cost");
    const Real norm = expected.gradient.norm();
    ExpectNear(found.gradient_norm, norm, 1e-12L * norm, "gradient");
    const Real max = expected.num_columns > 0 ? expected.gradient.cwiseAbs().maxCoeff() : 0;
    ExpectNear(found.gradient_max_norm, max, 1e-12L * norm, "gradient's largest entry");
  }

  void CheckSystem(const EliminatedEquations& expected, const LinearizedProblem& problem) const {
    const int n = problem.num_camera_columns;
    ASSERT_EQ(solver_.matrix.rows(), n);
    const RealVector size = expected.camera.diagonal().cwiseSqrt();
    const Real residual_norm = std::sqrt(2 * problem.cost) + 1e-300L;
    Real worst_matrix = 0, worst_diagonal = 0, worst_rhs = 0;
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) {
        const Real scale = size[i] * size[j];
        worst_matrix =
            std::max(worst_matrix, std::abs(solver_.matrix(i, j) - expected.reduced(i, j)) / scale);
        if (solver_.camera_diagonal(i, j) == 0) continue;  // of another block
        worst_diagonal =
            std::max(worst_diagonal,
                     std::abs(solver_.camera_diagonal(i, j) - expected.camera(i, j)) / scale);
      }
      EXPECT_NE(solver_.camera_diagonal(j, j), 0);
      worst_rhs = std::max(worst_rhs,
                           std::abs(solver_.rhs[j] - expected.rhs[j]) / (size[j] * residual_norm));
      const Real scale = std::sqrt(damping_.squared_scale()[j]);
      ExpectNear(solver_.scale()[j], scale, 1e-13L * scale, "Jacobi scaling");
    }
    EXPECT_LE(worst_matrix, 1e-12L) << "S";
    EXPECT_LE(worst_diagonal, 1e-12L) << "block diagonal of the camera parameters";
    EXPECT_LE(worst_rhs, 1e-12L) << "b";
  }

  static Real ModelCostChange(const LinearizedProblem& problem, const RealVector& step) {
    const Real along = problem.gradient.dot(step);
    return -along - problem.JacobianTimes(step).squaredNorm() / 2;
  }

  void CheckNewtonCandidate(const LinearizedProblem& expected, const RealVector& q) {
    const Candidate candidate = schur_.EvaluateNewtonStep();
    const Real change = ModelCostChange(expected, q);
    ExpectNear(candidate.model_cost_change, change, 1e-9L * change, "model cost change");
    ExpectNear(candidate.step_norm, q.norm(), 1e-7L * q.norm(), "step");
  }

  void CheckProducts(const LinearizedProblem& expected, const RealVector& d_squared,
                     const RealVector& p, const RealVector& q) {
    const DoglegProducts found = schur_.Products();
    const RealVector dp = d_squared.cwiseProduct(p), dq = d_squared.cwiseProduct(q);
    const RealVector jp = expected.JacobianTimes(p), jq = expected.JacobianTimes(q);
    const Real d_pp = p.dot(dp), d_qq = q.dot(dq), j_pp = jp.squaredNorm(), j_qq = jq.squaredNorm();
    ExpectNear(found.d_pp, d_pp, 1e-11L * d_pp, "p D^2 p");
    ExpectNear(found.d_pq, p.dot(dq), 1e-7L * std::sqrt(d_pp * d_qq), "p D^2 q");
    ExpectNear(found.d_qq, d_qq, 1e-7L * d_qq, "q D^2 q");
    ExpectNear(found.j_pp, j_pp, 1e-11L * j_pp, "p J^T J p");
    ExpectNear(found.j_pq, jp.dot(jq), 1e-7L * std::sqrt(j_pp * j_qq), "p J^T J q");
    ExpectNear(found.j_qq, j_qq, 1e-7L * j_qq, "q J^T J q");
  }

  void CheckCombination(const LinearizedProblem& expected, const RealVector& p,
                        const RealVector& q) {
    // As a dogleg's: a step against the gradient, and part of Newton's.
    const Real a = -p.dot(expected.gradient) / (expected.JacobianTimes(p).squaredNorm() + 1e-300L);
    const auto rounded = static_cast<double>(0.3L * a);
    const RealVector step = rounded * p + 0.7L * q;
    const Candidate candidate = schur_.EvaluateDoglegStep(rounded, 0.7);
    const Real change = ModelCostChange(expected, step);
    ExpectNear(candidate.model_cost_change, change, 1e-8L * std::abs(change),
               "model cost change of a combination");
    ExpectNear(candidate.step_norm, step.norm(), 1e-7L * step.norm(), "step of a combination");
  }

  /// ||x|| over all that is refined.
  Real StateNorm() const {
    Real sum = 0;
    std::vector<double> quaternions = schur_.cameras().CamFromWorld();
    for (const auto& more : {schur_.cameras().RigFromWorld(), schur_.cameras().SensorFromRig()}) {
      quaternions.insert(quaternions.end(), more.begin(), more.end());
    }
    const auto points = schur_.Points();
    for (int p = 0; p < NumPoses(problem_); ++p) {
      const int camera = p < problem_.num_images ? problem_.image_camera[p] : 0;
      AddSquares(layout().pose_block(p), p, camera, quaternions, &sum);
    }
    for (int c = 0; c < problem_.num_cameras; ++c) {
      AddSquares(layout().camera_block(c), -1, c, quaternions, &sum);
    }
    for (int i = 0; i < 3 * problem_.num_points; ++i) {
      if (layout().point_is_free(i / 3)) sum += Real(points[i]) * points[i];
    }
    return std::sqrt(sum);
  }

  void AddSquares(int index, int image, int camera, const std::vector<double>& quaternions,
                  Real* sum) const {
    if (index < 0) return;
    const CameraBlock& block = layout().blocks()[index];
    for (int k = 0; k < block.size; ++k) {
      const int column = block.columns[k];
      Real value;
      if (column < 3) {
        value = RotationVector(image, quaternions)[column];
      } else if (column < kPoseSize) {
        value = quaternions[7 * static_cast<size_t>(image) + 4 + column - 3];
      } else {
        value = schur_.cameras().params(camera)[column - kPoseSize];
      }
      *sum += value * value;
    }
  }

  /// w of Exp(w) q0 = q.
  RealVector RotationVector(int image, const std::vector<double>& quaternions) const {
    const double* start = ValueOfPose(problem_, image);
    const double inverse[4] = {-start[0], -start[1], -start[2], start[3]};
    double w[4];
    QuaternionProduct(&quaternions[7 * static_cast<size_t>(image)], inverse, w);
    RealVector vector(3);
    vector << w[0], w[1], w[2];
    const Real sine = vector.norm();
    return sine == 0 ? vector : RealVector(vector * (2 * std::atan2(sine, Real(w[3])) / sine));
  }

  const AdjustmentProblem problem_;
  const SolveOptions options_;
  const PreparedSolve prepared_;
  CapturingSolver solver_;
  SchurProblem schur_;
  const LinearizedProblem first_;
  const Damping damping_;
};

inline SolveOptions Options() {
  SolveOptions options;
  options.loss_scale = 5;
  options.num_threads = 2;
  return options;
}

/// At the start, again with another damping, and after a step.
inline void CheckAlongTheWay(Comparison* comparison) {
  comparison->Check(1e-4);
  comparison->Check(1e2);
  comparison->Step();
  comparison->Check(1e-3);
}

}  // namespace bundle
