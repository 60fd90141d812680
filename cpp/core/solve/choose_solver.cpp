/// Choosing a linear solver by the shape of the problem.
///
/// With the points eliminated, what is left to solve is the reduced camera system S of n columns.
/// Its dense factorisation takes n^3 / 3 multiply-adds at the full rate of the machine; the sparse
/// one saves what S has of zeros but runs at a lower rate and fills in, so it pays only where S is
/// large and sparse. Where even the sparse factor grows too large, conjugate gradients need only
/// products with S.

#include "core/solve/choose_solver.h"

#include <cmath>

#include "core/solve/memory.h"

namespace bundle {
namespace {

constexpr int64_t kSmallSystem = 600;          // columns: below, dense costs milliseconds
constexpr int64_t kLargestFactorised = 30000;  // columns: above, factors outgrow the machine
constexpr double kDenseFill = 0.35;            // share of nonzero pairs that fills in to dense

/// "The reduced camera system (5000 columns)"
std::string Subject(const ProblemShape& shape) {
  return "The reduced camera system (" + std::to_string(shape.num_camera_columns) + " columns)";
}

}  // namespace

SolverChoice ChooseLinearSolver(const ProblemView& problem, const ParameterLayout& layout,
                                const ProblemShape& shape) {
  if (shape.num_free_points == 0) {
    return {LinearSolverType::kSparseNormalCholesky,
            "No point is refined, so there is nothing to eliminate: the camera blocks are solved "
            "sparsely."};
  }
  const int64_t columns = shape.num_camera_columns;
  if (columns <= kSmallSystem) {
    return {LinearSolverType::kDenseSchur,
            Subject(shape) + " is small: its dense factorisation costs milliseconds."};
  }
  const double density = columns > kLargestFactorised ? -1 : CountSchurDensity(problem, layout);
  if (density < 0) {
    return {LinearSolverType::kIterativeSchur,
            Subject(shape) + " is too large to factorise: it is solved by conjugate gradients."};
  }
  const std::string full = std::to_string(std::lround(100 * density)) + " % full";
  const bool fits = PredictDenseMatrixBytes(LinearSolverType::kDenseSchur, shape, false) <
                    0.5 * AvailableMemoryBytes();
  if (density >= kDenseFill && fits) {
    return {LinearSolverType::kDenseSchur,
            Subject(shape) + " is " + full + ": dense factorisation beats sparse."};
  }
  return {LinearSolverType::kSparseSchur,
          Subject(shape) + " is only " + full + ": sparse factorisation skips the rest."};
}

}  // namespace bundle
