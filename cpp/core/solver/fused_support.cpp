#include "core/solver/fused_support.h"

#include <cstdint>

#include "core/schur/elimination_plan.h"

namespace bundle {

namespace {

bool IsSupported(LinearSolverType type) {
  return type == LinearSolverType::kAuto || type == LinearSolverType::kDenseSchur ||
         type == LinearSolverType::kSparseSchur || type == LinearSolverType::kIterativeSchur;
}

bool IsSupported(PreconditionerType type) {
  using Type = PreconditionerType;
  return type == Type::kAuto || type == Type::kIdentity || type == Type::kJacobi ||
         type == Type::kSchurJacobi || type == Type::kSchurPowerSeriesExpansion ||
         type == Type::kTwoLevel;
}

/// True if the preconditioner is used.
bool MayIterate(LinearSolverType type) {
  return type == LinearSolverType::kAuto || type == LinearSolverType::kIterativeSchur;
}

bool RefinesBesidePoints(const SolveOptions& options) {
  return options.refine_poses || options.refine_focal || options.refine_principal_point ||
         options.refine_extra || options.refine_sensor_from_rig;
}

Unsupported NothingBesidePoints() {
  return {"refine", "poses or intrinsics in addition to points", "only points"};
}

/// The kernels damp by constants (minimize/damping.h), and every accepted step lowers the cost.
std::optional<Unsupported> FindUnsupportedSteps(const SolveOptions& options) {
  const SolveOptions usual;
  if (options.min_lm_diagonal != usual.min_lm_diagonal) {
    return Unsupported{"min_lm_diagonal", "1e-6", "another value"};
  }
  if (options.max_lm_diagonal != usual.max_lm_diagonal) {
    return Unsupported{"max_lm_diagonal", "1e32", "another value"};
  }
  if (options.use_nonmonotonic_steps) {
    return Unsupported{"use_nonmonotonic_steps", "false", "true"};
  }
  return std::nullopt;
}

}  // namespace

std::optional<Unsupported> FindUnsupported(const SolveOptions& options) {
  if (!IsSupported(options.linear_solver_type)) {
    return Unsupported{"linear_solver_type", "auto, dense_schur, sparse_schur or iterative_schur",
                       NameOf(options.linear_solver_type, kLinearSolverTypes)};
  }
  if (options.linear_solver_ordering != EliminationOrdering::kPointsFirst) {
    return Unsupported{"linear_solver_ordering", "points_first",
                       NameOf(options.linear_solver_ordering, kEliminationOrderings)};
  }
  if (MayIterate(options.linear_solver_type) && !IsSupported(options.preconditioner_type)) {
    return Unsupported{"preconditioner_type",
                       "identity, jacobi, schur_jacobi, schur_power_series_expansion or two_level",
                       NameOf(options.preconditioner_type, kPreconditionerTypes)};
  }
  if (!RefinesBesidePoints(options)) return NothingBesidePoints();
  return FindUnsupportedSteps(options);
}

std::optional<Unsupported> FindUnsupported(const SolveOptions& options,
                                           const PreparedSolve& prepared) {
  const std::optional<Unsupported> by_options = FindUnsupported(options);
  if (by_options) return by_options;
  if (prepared.layout.blocks().empty()) return NothingBesidePoints();
  const int64_t longest_track = prepared.longest_track;
  if (longest_track > kMaxTrackLength) {
    return Unsupported{"backend",
                       "at most " + std::to_string(kMaxTrackLength) + " observations per point",
                       "a point with " + std::to_string(longest_track)};
  }
  if (!prepared.factor_for_ceres.empty()) {
    return Unsupported{"factors", "factors of images and cameras, or of one point,",
                       prepared.factor_for_ceres};
  }
  return std::nullopt;
}

}  // namespace bundle
