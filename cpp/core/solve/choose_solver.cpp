/// Choosing a linear solver by the shape of the problem.
///
/// With the points eliminated, what is left to solve is the reduced camera system S of n columns,
/// of whose block pairs the share d is not zero. Its dense factorisation takes n^3 / 3
/// multiply-adds at the full rate of the machine. The sparse one saves what S has of zeros but
/// fills in and runs at a lower rate, so it pays only where S is large and sparse. Where even the
/// sparse factor grows too large, conjugate gradients need only products with S.
///
/// Without a symbolic factorisation its cost is a guess: on synthetic streets, orbits and photo
/// collections of 300 to 4000 images the factor had about 4 d n entries a column, hence n (4 d n)^2
/// multiply-adds. The bounds below are where the measured times of the solvers crossed.

#include "core/solve/choose_solver.h"

#include <algorithm>
#include <cmath>

#include "core/solve/memory.h"

namespace bundle {
namespace {

constexpr int64_t kSmallSystem = 1000;          // columns: below, dense costs milliseconds
constexpr double kLargestFactorisation = 5e11;  // multiply-adds: above, iterating is faster
constexpr double kDenseFill = 0.35;             // share of nonzero pairs that fills in to dense

/// "The reduced camera system (5000 columns)"
std::string Subject(const ProblemShape& shape) {
  return "The reduced camera system (" + std::to_string(shape.num_camera_columns) + " columns)";
}

double FactorisationCost(int64_t columns, double density) {
  const auto n = static_cast<double>(columns);
  const double entries = std::min(1.0, 4 * density) * n;
  return n * entries * entries;
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
  const double density = CountSchurDensity(problem, layout);
  if (density < 0 || FactorisationCost(columns, density) > kLargestFactorisation) {
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
