#include "core/ceres/translate_options.h"

#include <algorithm>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/model/problem_factors.h"
#include "core/parallel/thread_pool.h"
#include "core/prepare/prepare.h"

namespace bundle {

namespace {

/// The blocks and points of group 0, an independent set.
struct FirstGroup {
  std::set<int> points_left_out;
  std::set<int> blocks_left_out;
};

/// Keeps in the group only the first of the unknowns of one kind in a factor.
FirstGroup FindFirstGroup(bool points_first, const AdjustmentProblem& problem,
                          const ParameterLayout& layout) {
  FirstGroup group;
  const auto keep_one = [](const std::vector<int>& members, std::set<int>* left_out) {
    bool is_first = true;
    for (const int member : members) {
      if (left_out->count(member) > 0) continue;
      if (!is_first) left_out->insert(member);
      is_first = false;
    }
  };
  if (!points_first) group.blocks_left_out = layout.BlocksBesideFirst();
  for (const FactorUnknowns& unknowns : FindFactorUnknowns(problem, layout)) {
    if (points_first) {
      keep_one(unknowns.points, &group.points_left_out);
    } else {
      keep_one(unknowns.blocks, &group.blocks_left_out);
    }
  }
  return group;
}

}  // namespace

std::shared_ptr<ceres::ParameterBlockOrdering> MakeOrdering(EliminationOrdering ordering,
                                                            const AdjustmentProblem& problem,
                                                            const ParameterLayout& layout,
                                                            double* points, double* state) {
  if (ordering == EliminationOrdering::kAutomatic) return nullptr;
  const bool points_first = ordering == EliminationOrdering::kPointsFirst;
  const FirstGroup first = FindFirstGroup(points_first, problem, layout);
  auto result = std::make_shared<ceres::ParameterBlockOrdering>();
  for (int p = 0; p < problem.num_points; ++p) {
    if (!layout.point_is_free(p)) continue;
    const bool is_first = points_first && first.points_left_out.count(p) == 0;
    result->AddElementToGroup(points + 3 * static_cast<int64_t>(p), is_first ? 0 : 1);
  }
  // The layout begins with blocks of images.
  for (size_t b = 0; b < layout.blocks().size(); ++b) {
    const bool is_first = !points_first && first.blocks_left_out.count(static_cast<int>(b)) == 0;
    result->AddElementToGroup(state + layout.blocks()[b].offset, is_first ? 0 : 1);
  }
  return result;
}

bool FactorsCoupleFirstGroup(EliminationOrdering ordering, const AdjustmentProblem& problem,
                             const ParameterLayout& layout) {
  const auto unknowns = FindFactorUnknowns(problem, layout);
  return std::any_of(unknowns.begin(), unknowns.end(), [ordering](const FactorUnknowns& of) {
    return ordering == EliminationOrdering::kPointsFirst ? of.points.size() > 1
                                                         : of.blocks.size() > 1;
  });
}

bool NothingToEliminate(EliminationOrdering ordering, const ParameterLayout& layout) {
  const bool no_points = layout.num_free_points() == 0;
  const bool no_cameras = layout.blocks().empty();
  if (ordering == EliminationOrdering::kPointsFirst) return no_points && !no_cameras;
  if (ordering == EliminationOrdering::kCamerasFirst) return no_cameras && !no_points;
  return false;
}

namespace {

std::mutex mutex;
int num_holders = 0;
int saved_log_level = 0;

}  // namespace

ProcessSettings::ProcessSettings(int blas_threads) : blas_threads_(blas_threads) {
  const std::lock_guard<std::mutex> lock(mutex);
  if (num_holders++ > 0) return;
  saved_log_level = ExchangeLogLevel(kPrintNothing);
}

ProcessSettings::~ProcessSettings() {
  const std::lock_guard<std::mutex> lock(mutex);
  if (--num_holders == 0) ExchangeLogLevel(saved_log_level);
}

namespace {

bool IsSparseDirect(LinearSolverType type) {
  return type == LinearSolverType::kSparseSchur || type == LinearSolverType::kSparseNormalCholesky;
}

ceres::PreconditionerType ToCeres(PreconditionerType type, LinearSolverType solver) {
  switch (type) {
    case PreconditionerType::kAuto:
      return solver == LinearSolverType::kIterativeSchur ? ceres::SCHUR_JACOBI : ceres::JACOBI;
    case PreconditionerType::kIdentity:
      return ceres::IDENTITY;
    case PreconditionerType::kJacobi:
      return ceres::JACOBI;
    case PreconditionerType::kSchurJacobi:
      return ceres::SCHUR_JACOBI;
    case PreconditionerType::kClusterJacobi:
      return ceres::CLUSTER_JACOBI;
    case PreconditionerType::kClusterTridiagonal:
      return ceres::CLUSTER_TRIDIAGONAL;
    case PreconditionerType::kSchurPowerSeriesExpansion: {
      ceres::PreconditionerType result;
      if (PowerSeriesPreconditioner(&result)) return result;
      throw InputError(
          "preconditioner_type: schur_power_series_expansion needs Ceres 2.2, this is "
          "Ceres " CERES_VERSION_STRING);
    }
    case PreconditionerType::kTwoLevel:
      throw InputError("preconditioner_type: expected a preconditioner of Ceres, found two_level");
  }
  throw InputError("preconditioner_type: expected a preconditioner");
}

/// Ceres 2.1 aborts the process for CGNR with preconditioners other than IDENTITY and JACOBI.
void CheckPreconditioner(const SolveOptions& options, ceres::PreconditionerType preconditioner) {
  const bool plain = preconditioner == ceres::IDENTITY || preconditioner == ceres::JACOBI;
  const std::string name = ceres::PreconditionerTypeToString(preconditioner);
  if (options.linear_solver_type == LinearSolverType::kCgnr && !plain) {
    throw InputError("preconditioner_type: expected identity or jacobi with cgnr, found " + name);
  }
  const bool clusters =
      preconditioner == ceres::CLUSTER_JACOBI || preconditioner == ceres::CLUSTER_TRIDIAGONAL;
  if (clusters && !ceres::IsSparseLinearAlgebraLibraryTypeAvailable(ceres::SUITE_SPARSE)) {
    throw InputError("preconditioner_type: " + name +
                     " needs SuiteSparse, but this Ceres was built without it");
  }
}

void SetSchurComplement(const SolveOptions& options, ceres::Solver::Options* result) {
  if (options.linear_solver_type != LinearSolverType::kIterativeSchur) return;
  result->use_explicit_schur_complement = options.schur_complement == SchurComplement::kExplicit;
  if (!result->use_explicit_schur_complement) return;
  if (result->preconditioner_type == ceres::SCHUR_JACOBI) return;
  throw InputError(
      "schur_complement: expected auto or implicit, because Ceres forms the reduced camera system "
      "with schur_jacobi only, found explicit");
}

void SetLinearSolver(const SolveOptions& options, ceres::Solver::Options* result) {
  const LinearSolverType type = options.linear_solver_type;
  result->linear_solver_type = bundle::ToCeres(type);
  const bool has_suite_sparse =
      ceres::IsSparseLinearAlgebraLibraryTypeAvailable(ceres::SUITE_SPARSE);
  if (IsSparseDirect(type) && !has_suite_sparse) {
    throw InputError(
        "linear_solver_type: " + std::string(LinearSolverTypeToString(result->linear_solver_type)) +
        " needs SuiteSparse, but this Ceres was built without it");
  }
  if (has_suite_sparse) result->sparse_linear_algebra_library_type = ceres::SUITE_SPARSE;
  if (ceres::IsDenseLinearAlgebraLibraryTypeAvailable(ceres::LAPACK)) {
    result->dense_linear_algebra_library_type = ceres::LAPACK;
  }
  if (IsIterative(type)) {
    result->preconditioner_type = ToCeres(options.preconditioner_type, type);
    CheckPreconditioner(options, result->preconditioner_type);
    SetSchurComplement(options, result);
  }
}

void SetTrustRegion(const SolveOptions& options, ceres::Solver::Options* result) {
  if (options.trust_region_strategy_type == TrustRegionStrategy::kLevenbergMarquardt) {
    result->trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
    return;
  }
  result->trust_region_strategy_type = ceres::DOGLEG;
  result->dogleg_type = options.trust_region_strategy_type == TrustRegionStrategy::kDogleg
                            ? ceres::TRADITIONAL_DOGLEG
                            : ceres::SUBSPACE_DOGLEG;
}

}  // namespace

ceres::LinearSolverType ToCeres(LinearSolverType type) {
  switch (type) {
    case LinearSolverType::kDenseSchur:
      return ceres::DENSE_SCHUR;
    case LinearSolverType::kSparseSchur:
      return ceres::SPARSE_SCHUR;
    case LinearSolverType::kIterativeSchur:
      return ceres::ITERATIVE_SCHUR;
    case LinearSolverType::kDenseNormalCholesky:
      return ceres::DENSE_NORMAL_CHOLESKY;
    case LinearSolverType::kSparseNormalCholesky:
      return ceres::SPARSE_NORMAL_CHOLESKY;
    case LinearSolverType::kDenseQr:
      return ceres::DENSE_QR;
    case LinearSolverType::kCgnr:
      return ceres::CGNR;
    case LinearSolverType::kAuto:
      break;
  }
  throw InputError("linear_solver_type: expected a solver");
}

ceres::Solver::Options TranslateOptions(const SolveOptions& options) {
  ceres::Solver::Options result;
  result.minimizer_type = ceres::TRUST_REGION;
  result.logging_type = ceres::SILENT;
  result.minimizer_progress_to_stdout = false;
  result.max_num_iterations = options.max_num_iterations;
  result.function_tolerance = options.function_tolerance;
  result.gradient_tolerance = options.gradient_tolerance;
  result.parameter_tolerance = options.parameter_tolerance;
  result.initial_trust_region_radius = options.initial_trust_region_radius;
  result.num_threads = EffectiveNumThreads(options.num_threads);
  result.max_trust_region_radius = options.max_trust_region_radius;
  result.min_trust_region_radius = options.min_trust_region_radius;
  result.min_relative_decrease = options.min_relative_decrease;
  result.min_lm_diagonal = options.min_lm_diagonal;
  result.max_lm_diagonal = options.max_lm_diagonal;
  result.use_nonmonotonic_steps = options.use_nonmonotonic_steps;
  result.max_consecutive_nonmonotonic_steps = options.max_consecutive_nonmonotonic_steps;
  // If a factorisation fails because the damping has become too small, it is repeated with a radius
  // 2, 4, 8, ... times smaller. Ceres gives up the solve after five failures, COLMAP after ten. Ten
  // reduce the radius by 2^55, after which rounding cannot be the cause.
  result.max_num_consecutive_invalid_steps = options.max_num_consecutive_invalid_steps;
  SetLinearSolver(options, &result);
  CheckTrustRegion(options);
  SetTrustRegion(options, &result);
  std::string error;
  if (!result.IsValid(&error)) throw InputError("options: " + error);
  return result;
}

}  // namespace bundle
