#include "core/prepare/choose_solver.h"

/// Choice of a linear solver.
///
/// For Ceres, the choice depends on the shape of the problem. With the points eliminated, the
/// reduced camera system S has n columns, and a share d of its block pairs is nonzero. Its dense
/// factorisation takes n^3 / 3 multiply-adds at the full rate of the machine. The sparse one skips
/// the zeros of S but has fill-in and runs at a lower rate, so it is faster only if S is large and
/// sparse. If even the sparse factor becomes too large, conjugate gradients need only products with
/// S.
///
/// With the cameras eliminated instead, the reduced system has 3 columns per point. It is nearly
/// full, because all points that an image sees are coupled. It is factorised if it is small.
///
/// Without a symbolic factorisation, the cost is an estimate. On synthetic streets, orbits and
/// photo collections of 300 to 4000 images, the factor had about 4 d n entries per column, hence n
/// (4 d n)^2 multiply-adds. The bounds below are where the measured times of the solvers were
/// equal.
///
/// For the fused backend, by predicted time. For S of n columns, s stored values and a factor of l
/// entries and f flops (supernodes.cpp counts both exactly), one solve takes
///
///   dense      n^3 / 3 at the rate of dpotrf or of our kernels (linear/tiled_cholesky), and 8 n^2
///              bytes for the substitutions
///   sparse     f at the rate of our kernels, and a time for each entry of the factor, which is
///              assembled beside the flops and used by the substitutions
///   iterative  8 s bytes from memory for each product with S; with two levels
///              (preconditioners.cpp) a time for each value of S, which goes into the coarse system
///              once, and two passes over the coarse factor beside each product: about l / 20
///              entries, as a fifth of the columns is left
///   implicit   a pass over the observations for each product (schur/implicit_product.cpp)
///
/// All but the last also form S: a pair of images that see a point adds a product of rank 3 to a
/// block of b x b, 3 b^2 multiply-adds at a seventh of the kernels' rate or less.
///
/// Measured on a server core (AVX-512, OpenBLAS 0.3.21): dpotrf of 2000 columns 37 GFLOP/s, our
/// kernels 75 to 110 from 184 to 2000 columns; sparse factors of streets, orbits and a photo
/// collection, f from 2e7 to 3e10, one thread and two: within 35 % of f / 80 GFLOP/s + 2 ns l (43
/// GFLOP/s with AVX2, 8 with the baseline); products with S 8 GB/s; a pass 28 to 34 ns an
/// observation (42 and 75). Bandwidth is that of at most four cores.
///
/// Conjugate gradients with two levels took 2 to 100 products per step (streets of 50 to 1000
/// images and 1000 of a photo collection), more towards the end. Their steps gain a little less
/// than exact ones. So 80 products are assumed, and a direct solver that takes up to 15 % longer is
/// still preferred. The coarse system took 10 ns per value. Without S there is no coarse system.
/// Schur-Jacobi took the fewer products the fuller S: 5 to 40 on average where more than half of it
/// is full (tracks of 30 to 300 images, small real models), 20 to 60 at a share of 0.1 to 0.2,
/// hundreds on streets. 30 over the share are assumed.

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "core/linear/block_structure.h"
#include "core/linear/direct_solvers.h"
#include "core/linear/supernodes.h"
#include "core/linear/tiled_cholesky.h"
#include "core/model/coupled_blocks.h"
#include "core/parallel/blas.h"
#include "core/parallel/instruction_set.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/memory.h"
#include "core/symbolic/factor_counts.h"

namespace bundle {

namespace {

constexpr int64_t kSmallSystem = 1000;  // columns: with fewer, a dense solve costs milliseconds
constexpr double kLargestFactorisation = 5e11;  // multiply-adds: with more, iterating is faster
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

constexpr double kBlasFlopsPerSecond = 40e9;  // of a core
constexpr double kBytesPerSecond = 8e9;       // of a core
constexpr double kCoresThatFillMemory = 4;
constexpr double kSecondsPerFactorEntry = 2e-9;
constexpr double kFormingShare = 1.0 / 7;   // of the kernels' rate
constexpr double kSupernodalPadding = 1.2;  // zeros that panels store, and upper triangles
constexpr double kProductsPerStep = 80;
constexpr double kSecondsPerCoarseValue = 10e-9;
constexpr double kMostImplicitProducts = 240, kImplicitProductsOfFullSystem = 30;
constexpr double kSecondsWorthAnotherWay = 5e-3;  // two levels are the safer way
constexpr double kCoarseFactorShare =
    0.05;  // share of the coarse factor in the entries of the full factor
constexpr double kExactStepsAreWorth = 1.15;
constexpr double kShareOfMemory = 0.7;

/// Rates of our kernels on a core.
struct KernelRates {
  double flops_per_second;
  double seconds_per_observation;  ///< time of a product with S that is not formed
};

KernelRates OwnRates() {
  switch (BestInstructionSet()) {
    case InstructionSet::kAvx512:
      return {80e9, 32e-9};
    case InstructionSet::kAvx2:
      return {43e9, 42e-9};
    default:
      return {8e9, 75e-9};
  }
}

std::string FormatSeconds(double seconds) {
  constexpr double kLeast = 0.01;
  const bool is_short = seconds < 1;
  const double value = is_short ? std::max(1e3 * seconds, kLeast) : seconds;
  char text[32];
  std::snprintf(text, sizeof(text), value < 10 ? "%.2g %s" : "%.0f %s", value,
                is_short ? "ms" : "s");
  return text;
}

std::string Describe(const LinearSolverCost& cost, double available_bytes) {
  if (cost.bytes > kShareOfMemory * available_bytes) return "needs " + FormatBytes(cost.bytes);
  return FormatSeconds(cost.seconds);
}

BlockStructure StructureOf(const BlockPatternView& pattern) {
  std::vector<std::vector<int>> columns(pattern.num_blocks);
  for (int j = 0; j < pattern.num_blocks; ++j) {
    columns[j].assign(pattern.row + pattern.column_begin[j],
                      pattern.row + pattern.column_begin[j + 1]);
  }
  return SparseStructure({pattern.size, pattern.size + pattern.num_blocks}, columns);
}

/// With more blocks, the count takes longer than the better choice saves.
constexpr int kMaxBlocksToCount = 20000;

/// Share of the nonzero block pairs of S (both triangles and the diagonal). -1 if there are too
/// many blocks to count it.
double CountSchurDensity(const AdjustmentProblem& problem, const ParameterLayout& layout) {
  const auto n = static_cast<int64_t>(layout.blocks().size());
  if (n == 0 || n > kMaxBlocksToCount) return -1;
  int64_t lower = 0;
  for (const std::vector<int>& column : FindCoupledBlocks(problem, layout)) {
    lower += static_cast<int64_t>(column.size());
  }
  return static_cast<double>(2 * lower - n) / (static_cast<double>(n) * static_cast<double>(n));
}

SolverChoice ChooseForPoints(const ProblemShape& shape) {
  const int64_t columns = 3 * shape.num_free_points;
  const std::string subject =
      "The reduced system of the points (" + std::to_string(columns) + " columns)";
  if (columns <= kSmallSystem) {
    return {LinearSolverType::kDenseSchur,
            subject + " is small: its dense factorisation costs milliseconds."};
  }
  return {LinearSolverType::kIterativeSchur,
          subject + " is too large to factorise: it is solved by conjugate gradients."};
}

}  // namespace

SolverChoice ChooseCeresSolver(const AdjustmentProblem& problem, const ParameterLayout& layout,
                               const ProblemShape& shape, bool cameras_eliminated) {
  if (shape.num_free_points == 0) {
    return {LinearSolverType::kSparseNormalCholesky,
            "No point is refined, so there is nothing to eliminate: the camera blocks are solved "
            "sparsely."};
  }
  if (cameras_eliminated && shape.num_camera_columns > 0) return ChooseForPoints(shape);
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

LinearSolverCosts PredictLinearSolverCosts(const BlockStructure& structure,
                                           const FillOrdering& ordering, int num_threads,
                                           int64_t num_observations, int64_t num_pairs) {
  const KernelRates own = OwnRates();
  const double threads = EffectiveNumThreads(num_threads);
  const double bandwidth = kBytesPerSecond * std::min(threads, kCoresThatFillMemory);
  const double n = structure.num_columns();
  const auto values = static_cast<double>(structure.num_values);
  LinearSolverCosts costs;
  costs.dense.flops = n * n * n / 3;
  costs.dense.bytes = 8 * n * n;
  double dense_rate = kBlasFlopsPerSecond * (n >= kColumnsWorthBlasThreads ? threads : 1);
  if (BestInstructionSet() == InstructionSet::kAvx512) {
    dense_rate = own.flops_per_second * (n >= kColumnsWorthTiles ? threads : 1);
  }
  costs.dense.seconds = costs.dense.flops / dense_rate + costs.dense.bytes / bandwidth;

  costs.sparse.flops = ordering.flops;
  costs.sparse.bytes = 8 * kSupernodalPadding * ordering.entries;
  const double sparse_threads = ordering.flops >= kFlopsWorthThreads ? threads : 1;
  costs.sparse.seconds = ordering.flops / (own.flops_per_second * sparse_threads) +
                         kSecondsPerFactorEntry * ordering.entries;

  const double coarse_entries = kCoarseFactorShare * ordering.entries;
  costs.iterative.flops = 4 * (values + coarse_entries) * kProductsPerStep;
  costs.iterative.bytes = 8 * (values + kSupernodalPadding * coarse_entries);
  costs.iterative.seconds = 8 * (values + 2 * coarse_entries) / bandwidth * kProductsPerStep +
                            kSecondsPerCoarseValue * values / threads;
  const double density = std::min(1.0, 2 * values / std::max(1.0, n * n));
  const double products =
      std::min(kMostImplicitProducts, kImplicitProductsOfFullSystem / std::max(density, 1e-9));
  costs.implicit.seconds = num_observations == 0
                               ? std::numeric_limits<double>::infinity()
                               : products * own.seconds_per_observation *
                                     static_cast<double>(num_observations) / threads;
  const double block = n / std::max(1, structure.num_blocks());
  costs.forming_seconds = static_cast<double>(num_pairs) * 3 * block * block /
                          (kFormingShare * own.flops_per_second * threads);
  return costs;
}

bool LeavesOutSystem(const LinearSolverCosts& costs, double available_bytes) {
  const bool fits = costs.iterative.bytes <= kShareOfMemory * available_bytes;
  return fits ? costs.implicit.seconds + kSecondsWorthAnotherWay <
                    costs.iterative.seconds + costs.forming_seconds
              : std::isfinite(costs.implicit.seconds);
}

SolverChoice ChooseLinearSolver(const BlockStructure& structure, const FillOrdering& ordering,
                                int num_threads, double available_bytes, int64_t num_observations,
                                int64_t num_pairs) {
  LinearSolverCosts costs =
      PredictLinearSolverCosts(structure, ordering, num_threads, num_observations, num_pairs);
  SolverChoice choice{LinearSolverType::kIterativeSchur, ""};
  const bool is_implicit = LeavesOutSystem(costs, available_bytes);
  for (LinearSolverCost* cost : {&costs.dense, &costs.sparse, &costs.iterative}) {
    cost->seconds += costs.forming_seconds;
  }
  choice.leaves_out_system = is_implicit;
  const LinearSolverCost& iterative = is_implicit ? costs.implicit : costs.iterative;
  double seconds = kExactStepsAreWorth * iterative.seconds;
  const auto consider = [&](LinearSolverType type, const LinearSolverCost& cost) {
    if (cost.bytes > kShareOfMemory * available_bytes || cost.seconds > seconds) return;
    choice.type = type;
    seconds = cost.seconds;
  };
  consider(LinearSolverType::kSparseSchur, costs.sparse);
  consider(LinearSolverType::kDenseSchur, costs.dense);
  choice.reason = "Expected time per step to form and solve the reduced camera system (" +
                  std::to_string(structure.num_columns()) + " columns): dense " +
                  Describe(costs.dense, available_bytes) + ", sparse " +
                  Describe(costs.sparse, available_bytes) + ", conjugate gradients " +
                  Describe(iterative, available_bytes) +
                  (is_implicit ? " (without forming it)." : ".");
  return choice;
}

double CountPanelValues(const BlockPatternView& pattern, const std::vector<int>& order) {
  std::vector<int> postordered;
  for (const int position : CountFactor(pattern, order).postorder) {
    postordered.push_back(order[position]);
  }
  const Supernodes supernodes = FindSupernodes(Reorder(StructureOf(pattern), postordered));
  return static_cast<double>(supernodes.values_begin.back());
}

SolverChoice ChooseByPattern(const BlockPatternView& pattern, int num_threads,
                             int64_t num_observations, int64_t num_pairs) {
  const BlockStructure structure = StructureOf(pattern);
  return ChooseLinearSolver(structure, FindFillOrdering(structure), num_threads,
                            AvailableMemoryBytes(), num_observations, num_pairs);
}

}  // namespace bundle
