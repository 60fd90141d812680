/// What `auto` rests on. For S of n columns, s stored values and a factor of l entries and f flops
/// (fill_ordering.cpp counts both exactly), one solve takes
///
///   dense      n^3 / 3 at the rate of dpotrf, and 8 n^2 bytes for the substitutions
///   sparse     f at the same rate, and a time for each entry of the factor, which is put together
///              run by run beside the flops and substituted with
///   iterative  8 s bytes from memory for each product with S; with two levels (two_level.cpp) a
///              time for each value of S, which goes into the coarse system once, and two passes
///              over the coarse factor beside each product: about l / 20 entries, as a fifth of the
///              columns is left
///
/// Measured on a server core (AVX-512, OpenBLAS 0.3.21) in processor time: dpotrf of 2000 columns
/// 37 GFLOP/s; supernodal_cholesky on bands, grids and random couplings of 33 to 3000 blocks of 9,
/// f from 2e6 to 3e10: within 30 % of f / 40 GFLOP/s + 7 ns l; products with S 8 GB/s. OpenBLAS'
/// threads are counted where they are used, and bandwidth as that of at most four cores.
///
/// Conjugate gradients with two levels took 2 to 100 products a step (streets of 50 to 1000 images
/// and 1000 of a photo collection), more towards the end, and their steps gain a little less than
/// exact ones: 80 are counted, and a direct solver that takes 15 % longer is preferred still. The
/// coarse system took 10 ns a value.

#include "core/fused/reduced/reduced_cost.h"

#include <algorithm>
#include <cstdio>

#include "core/blas_threads.h"
#include "core/parallel_for.h"
#include "core/solve/memory.h"

namespace bundle::fused {
namespace {

constexpr double kFlopsPerSecond = 40e9;  // of a core
constexpr double kBytesPerSecond = 8e9;   // of a core
constexpr double kCoresThatFillMemory = 4;
constexpr double kSecondsPerFactorEntry = 7e-9;
constexpr double kSupernodalPadding = 1.2;  // zeros that panels store, and upper triangles
constexpr double kProductsPerStep = 80;
constexpr double kSecondsPerCoarseValue = 10e-9;
constexpr double kCoarseFactorShare = 0.05;  // of the entries of the whole factor
constexpr double kExactStepsAreWorth = 1.15;
constexpr double kShareOfMemory = 0.7;

std::string FormatSeconds(double seconds) {
  char text[32];
  if (seconds < 1) {
    std::snprintf(text, sizeof(text), "%.2g ms", 1e3 * seconds);
  } else {
    std::snprintf(text, sizeof(text), "%.0f s", seconds);
  }
  return text;
}

std::string Describe(const ReducedCost& cost, double available_bytes) {
  if (cost.bytes > kShareOfMemory * available_bytes) return "needs " + FormatBytes(cost.bytes);
  return FormatSeconds(cost.seconds);
}

}  // namespace

ReducedCosts PredictReducedCosts(const ReducedStructure& structure, const FillOrdering& ordering,
                                 int num_threads) {
  const double threads = EffectiveNumThreads(num_threads);
  const double bandwidth = kBytesPerSecond * std::min(threads, kCoresThatFillMemory);
  const double n = structure.num_columns();
  const auto values = static_cast<double>(structure.num_values);
  const auto rate = [&](double average_column) {
    return kFlopsPerSecond * (average_column >= kColumnsWorthBlasThreads ? threads : 1);
  };
  ReducedCosts costs;
  costs.dense.flops = n * n * n / 3;
  costs.dense.bytes = 8 * n * n;
  costs.dense.seconds = costs.dense.flops / rate(n) + costs.dense.bytes / bandwidth;

  costs.sparse.flops = ordering.flops;
  costs.sparse.bytes = 8 * kSupernodalPadding * ordering.entries;
  const double average_column = ordering.flops / std::max(1.0, ordering.entries);
  costs.sparse.seconds =
      ordering.flops / rate(average_column) + kSecondsPerFactorEntry * ordering.entries;

  const double coarse_entries = kCoarseFactorShare * ordering.entries;
  costs.iterative.flops = 4 * (values + coarse_entries) * kProductsPerStep;
  costs.iterative.bytes = 8 * (values + kSupernodalPadding * coarse_entries);
  costs.iterative.seconds = 8 * (values + 2 * coarse_entries) / bandwidth * kProductsPerStep +
                            kSecondsPerCoarseValue * values / threads;
  return costs;
}

ReducedChoice ChooseReducedSolver(const ReducedStructure& structure, const FillOrdering& ordering,
                                  int num_threads, double available_bytes) {
  const ReducedCosts costs = PredictReducedCosts(structure, ordering, num_threads);
  ReducedChoice choice{LinearSolverType::kIterativeSchur, ""};
  double seconds = kExactStepsAreWorth * costs.iterative.seconds;
  const auto consider = [&](LinearSolverType type, const ReducedCost& cost) {
    if (cost.bytes > kShareOfMemory * available_bytes || cost.seconds > seconds) return;
    choice.type = type;
    seconds = cost.seconds;
  };
  consider(LinearSolverType::kSparseSchur, costs.sparse);
  consider(LinearSolverType::kDenseSchur, costs.dense);
  choice.reason = "Expected time per step of the reduced camera system (" +
                  std::to_string(structure.num_columns()) + " columns): dense " +
                  Describe(costs.dense, available_bytes) + ", sparse " +
                  Describe(costs.sparse, available_bytes) + ", conjugate gradients " +
                  Describe(costs.iterative, available_bytes) + ".";
  return choice;
}

}  // namespace bundle::fused
