#include "core/solve/solver_checks.h"

#include "core/error.h"
#include "core/solve/memory.h"
#include "core/solve/option_names.h"

namespace bundle {
namespace {

void Refuse(LinearSolverType type, double bytes, const char* what, const char* instead) {
  // Asking the system takes as long as a step of a small problem.
  constexpr double kFitsAnywhere = 1 << 20;
  if (bytes < kFitsAnywhere) return;
  const double available = AvailableMemoryBytes();
  if (bytes <= 0.9 * available) return;
  throw InputError("linear_solver_type: " + UpperName(type, kLinearSolverTypes) + " needs " +
                   FormatBytes(bytes) + " for its " + what + ", of which this machine has " +
                   FormatBytes(available) + " free; use " + instead);
}

}  // namespace

bool IsIterative(LinearSolverType type) {
  return type == LinearSolverType::kIterativeSchur || type == LinearSolverType::kCgnr;
}

void CheckTrustRegion(const SolveOptions& options) {
  if (IsIterative(options.linear_solver_type) &&
      options.trust_region_strategy_type != TrustRegionStrategy::kLevenbergMarquardt) {
    throw InputError(
        "trust_region_strategy_type: expected levenberg_marquardt with an iterative solver; dogleg "
        "needs exact steps");
  }
}

std::string FindIdlePreconditioner(const SolveOptions& options) {
  if (IsIterative(options.linear_solver_type) ||
      options.preconditioner_type == PreconditionerType::kAuto) {
    return "";
  }
  return "The preconditioner is not used: " +
         UpperName(options.linear_solver_type, kLinearSolverTypes) + " is a direct solver.";
}

std::string FindIdleOrdering(const SolveOptions& options) {
  const bool orders = options.linear_solver_type != LinearSolverType::kDenseNormalCholesky &&
                      options.linear_solver_type != LinearSolverType::kDenseQr &&
                      options.linear_solver_type != LinearSolverType::kCgnr;
  if (orders || options.linear_solver_ordering == EliminationOrdering::kPointsFirst) return "";
  return "The ordering is not used: " + UpperName(options.linear_solver_type, kLinearSolverTypes) +
         " does not eliminate block by block.";
}

void RefuseTooMuchMemory(LinearSolverType type, const ProblemShape& shape,
                         bool cameras_eliminated) {
  Refuse(type, PredictDenseMatrixBytes(type, shape, cameras_eliminated), "dense matrices",
         "sparse_schur or iterative_schur");
}

void RefuseTooMuchMemory(LinearSolverType type, double factor_bytes) {
  Refuse(type, factor_bytes, "factor", "iterative_schur");
}

}  // namespace bundle
