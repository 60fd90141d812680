#pragma once

/// Options of a solve, for both backends. Names, defaults and ranges are those of
/// python/bundle/interface/options.py (a test compares them), which checks the ranges. This header
/// includes no header of a solver; `ceres/translate_options.cpp` converts these options to those of
/// Ceres.

#include <cctype>
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/factors/loss.h"
#include "core/factors/reprojection.h"

namespace bundle {

enum class Backend { kAuto, kFused, kCeres };
enum class LinearSolverType {
  kAuto,
  kDenseSchur,
  kSparseSchur,
  kIterativeSchur,
  kDenseNormalCholesky,
  kSparseNormalCholesky,
  kDenseQr,
  kCgnr,
};
enum class EliminationOrdering { kPointsFirst, kCamerasFirst, kAutomatic };
enum class PreconditionerType {
  kAuto,
  kIdentity,
  kJacobi,
  kSchurJacobi,
  kClusterJacobi,
  kClusterTridiagonal,
  kSchurPowerSeriesExpansion,
  kTwoLevel,
};
enum class TrustRegionStrategy { kLevenbergMarquardt, kDogleg, kSubspaceDogleg };
enum class Gauge { kNone, kTwoCameras, kThreePoints };

template <typename Enum>
using NamedValue = std::pair<std::string_view, Enum>;

inline constexpr NamedValue<Backend> kBackends[] = {
    {"auto", Backend::kAuto}, {"fused", Backend::kFused}, {"ceres", Backend::kCeres}};
inline constexpr NamedValue<LinearSolverType> kLinearSolverTypes[] = {
    {"auto", LinearSolverType::kAuto},
    {"dense_schur", LinearSolverType::kDenseSchur},
    {"sparse_schur", LinearSolverType::kSparseSchur},
    {"iterative_schur", LinearSolverType::kIterativeSchur},
    {"dense_normal_cholesky", LinearSolverType::kDenseNormalCholesky},
    {"sparse_normal_cholesky", LinearSolverType::kSparseNormalCholesky},
    {"dense_qr", LinearSolverType::kDenseQr},
    {"cgnr", LinearSolverType::kCgnr}};
inline constexpr NamedValue<EliminationOrdering> kEliminationOrderings[] = {
    {"points_first", EliminationOrdering::kPointsFirst},
    {"cameras_first", EliminationOrdering::kCamerasFirst},
    {"automatic", EliminationOrdering::kAutomatic}};
inline constexpr NamedValue<PreconditionerType> kPreconditionerTypes[] = {
    {"auto", PreconditionerType::kAuto},
    {"identity", PreconditionerType::kIdentity},
    {"jacobi", PreconditionerType::kJacobi},
    {"schur_jacobi", PreconditionerType::kSchurJacobi},
    {"cluster_jacobi", PreconditionerType::kClusterJacobi},
    {"cluster_tridiagonal", PreconditionerType::kClusterTridiagonal},
    {"schur_power_series_expansion", PreconditionerType::kSchurPowerSeriesExpansion},
    {"two_level", PreconditionerType::kTwoLevel}};
inline constexpr NamedValue<TrustRegionStrategy> kTrustRegionStrategies[] = {
    {"levenberg_marquardt", TrustRegionStrategy::kLevenbergMarquardt},
    {"dogleg", TrustRegionStrategy::kDogleg},
    {"subspace_dogleg", TrustRegionStrategy::kSubspaceDogleg}};
inline constexpr NamedValue<LossType> kLossTypes[] = {
    {"trivial", LossType::kTrivial}, {"huber", LossType::kHuber},   {"soft_l1", LossType::kSoftL1},
    {"cauchy", LossType::kCauchy},   {"arctan", LossType::kArctan}, {"tukey", LossType::kTukey}};
inline constexpr NamedValue<Gauge> kGauges[] = {{"none", Gauge::kNone},
                                                {"two_cameras", Gauge::kTwoCameras},
                                                {"three_points", Gauge::kThreePoints}};
inline constexpr NamedValue<Cheirality> kCheiralities[] = {{"auto", Cheirality::kAuto},
                                                           {"algebraic", Cheirality::kAlgebraic},
                                                           {"zero", Cheirality::kZero}};

/// Conjugate gradients of the fused backend with S, or without forming it.
enum class SchurComplement { kAuto, kExplicit, kImplicit };

inline constexpr NamedValue<SchurComplement> kSchurComplements[] = {
    {"auto", SchurComplement::kAuto},
    {"explicit", SchurComplement::kExplicit},
    {"implicit", SchurComplement::kImplicit}};

/// Twists of images with rolling shutters (factors/rolling_shutter.h): variables, without or with
/// factors that tie them to the poses of their neighbours, or functions of these poses.
enum class Twists { kFree, kTied, kHard };

inline constexpr NamedValue<Twists> kTwists[] = {
    {"free", Twists::kFree}, {"tied", Twists::kTied}, {"hard", Twists::kHard}};

/// Rule by which a solve without a loss ends (minimize/sigma_rule.h): a distance to the minimum, or
/// Ceres' function tolerance alone, or this with gradients of rotations as COLMAP's Ceres measures
/// them (schur/linearize.cpp).
enum class ConvergenceRule { kSigmas, kCeres, kColmap };

inline constexpr NamedValue<ConvergenceRule> kConvergenceRules[] = {
    {"sigmas", ConvergenceRule::kSigmas},
    {"ceres", ConvergenceRule::kCeres},
    {"colmap", ConvergenceRule::kColmap}};

/// Ids of the rig and of the camera.
using SensorId = std::pair<int64_t, int64_t>;

struct SolveOptions {
  Backend backend = Backend::kAuto;
  LinearSolverType linear_solver_type = LinearSolverType::kAuto;
  EliminationOrdering linear_solver_ordering = EliminationOrdering::kPointsFirst;
  PreconditionerType preconditioner_type = PreconditionerType::kAuto;
  SchurComplement schur_complement = SchurComplement::kAuto;
  TrustRegionStrategy trust_region_strategy_type = TrustRegionStrategy::kLevenbergMarquardt;
  double initial_trust_region_radius = 1e4;
  double max_trust_region_radius = 1e16;
  double min_trust_region_radius = 1e-32;
  double min_relative_decrease = 1e-3;
  int max_num_consecutive_invalid_steps = 10;
  double min_lm_diagonal = 1e-6;  ///< other values with Ceres only, as the three that follow
  double max_lm_diagonal = 1e32;
  bool use_nonmonotonic_steps = false;
  int max_consecutive_nonmonotonic_steps = 5;
  LossType loss = LossType::kTrivial;
  double loss_scale = 1.0;  ///< pixels
  int max_num_iterations = 100;
  ConvergenceRule convergence = ConvergenceRule::kSigmas;
  double function_tolerance = 1e-6;
  double gradient_tolerance = 1e-10;
  double parameter_tolerance = 1e-8;
  int num_threads = 0;         ///< 0: all cores
  bool deterministic = false;  ///< the same bits for any number of threads
  bool refine_poses = true;
  bool refine_points = true;
  bool refine_focal = true;
  bool refine_principal_point = false;
  bool refine_extra = true;
  bool refine_readout = false;  ///< readouts of rolling shutters, by tied twists
  Twists twists = Twists::kFree;
  bool refine_sensor_from_rig = false;  ///< positions and rotations of sensors on their rigs
  std::vector<int64_t> fixed_camera_ids;
  std::vector<int64_t> fixed_image_ids;
  std::vector<int64_t> fixed_point_ids;
  std::vector<SensorId> fixed_sensors;
  Gauge gauge = Gauge::kNone;
  Cheirality cheirality = Cheirality::kAuto;
  bool check_solution = true;  ///< search for signs of a wrong Jacobian (checking/check_solution.h)
};

/// Times when an option may change: never in a Solver, or between its solves.
enum class Change { kNever, kBetweenSolves };

/// The list of all options except `refine`. Calls visit(change, name, member) for each option, or
/// visit(change, name, member, choices) if it has named choices. A new option needs a member above
/// and a line here; readers, writers and CopyChangeable use this list.
template <typename Visitor>
void VisitOptions(const Visitor& visit) {
  using Options = SolveOptions;
  constexpr Change kNever = Change::kNever, kBetweenSolves = Change::kBetweenSolves;
  visit(kNever, "backend", &Options::backend, kBackends);
  visit(kNever, "linear_solver_type", &Options::linear_solver_type, kLinearSolverTypes);
  visit(kNever, "linear_solver_ordering", &Options::linear_solver_ordering, kEliminationOrderings);
  visit(kNever, "preconditioner_type", &Options::preconditioner_type, kPreconditionerTypes);
  visit(kNever, "schur_complement", &Options::schur_complement, kSchurComplements);
  visit(kNever, "trust_region_strategy_type", &Options::trust_region_strategy_type,
        kTrustRegionStrategies);
  visit(kBetweenSolves, "initial_trust_region_radius", &Options::initial_trust_region_radius);
  visit(kBetweenSolves, "max_trust_region_radius", &Options::max_trust_region_radius);
  visit(kBetweenSolves, "min_trust_region_radius", &Options::min_trust_region_radius);
  visit(kBetweenSolves, "min_relative_decrease", &Options::min_relative_decrease);
  // clang-format off
  visit(kBetweenSolves, "max_num_consecutive_invalid_steps", &Options::max_num_consecutive_invalid_steps);
  visit(kNever, "max_consecutive_nonmonotonic_steps", &Options::max_consecutive_nonmonotonic_steps);
  // clang-format on
  visit(kNever, "min_lm_diagonal", &Options::min_lm_diagonal);
  visit(kNever, "max_lm_diagonal", &Options::max_lm_diagonal);
  visit(kNever, "use_nonmonotonic_steps", &Options::use_nonmonotonic_steps);
  visit(kBetweenSolves, "loss", &Options::loss, kLossTypes);
  visit(kBetweenSolves, "loss_scale", &Options::loss_scale);
  visit(kBetweenSolves, "max_num_iterations", &Options::max_num_iterations);
  visit(kBetweenSolves, "convergence", &Options::convergence, kConvergenceRules);
  visit(kBetweenSolves, "function_tolerance", &Options::function_tolerance);
  visit(kBetweenSolves, "gradient_tolerance", &Options::gradient_tolerance);
  visit(kBetweenSolves, "parameter_tolerance", &Options::parameter_tolerance);
  visit(kNever, "num_threads", &Options::num_threads);
  visit(kNever, "deterministic", &Options::deterministic);
  visit(kNever, "fixed_camera_ids", &Options::fixed_camera_ids);
  visit(kNever, "fixed_image_ids", &Options::fixed_image_ids);
  visit(kNever, "fixed_point_ids", &Options::fixed_point_ids);
  visit(kNever, "refine_sensor_from_rig", &Options::refine_sensor_from_rig);
  visit(kNever, "fixed_sensors", &Options::fixed_sensors);
  visit(kNever, "refine_readout", &Options::refine_readout);
  visit(kNever, "twists", &Options::twists, kTwists);
  visit(kNever, "gauge", &Options::gauge, kGauges);
  visit(kNever, "cheirality", &Options::cheirality, kCheiralities);
  visit(kBetweenSolves, "check_solution", &Options::check_solution);
}

/// The list of the names in `refine`. Calls visit(name, member) for each.
template <typename Visitor>
void VisitRefine(const Visitor& visit) {
  visit("poses", &SolveOptions::refine_poses);
  visit("points", &SolveOptions::refine_points);
  visit("focal", &SolveOptions::refine_focal);
  visit("principal_point", &SolveOptions::refine_principal_point);
  visit("extra", &SolveOptions::refine_extra);
}

/// Copies the options that may differ from one solve of a Solver to the next: the radius at the
/// start, the loss, the stopping rules, and the checks after the solve.
inline void CopyChangeable(const SolveOptions& from, SolveOptions* to) {
  VisitOptions([&](Change change, const char* /*name*/, auto member, const auto&... /*choices*/) {
    if (change == Change::kBetweenSolves) to->*member = from.*member;
  });
}

/// Name of an option's value as users write it: "dense_schur".
template <typename Enum, size_t kSize>
std::string NameOf(Enum value, const NamedValue<Enum> (&names)[kSize]) {
  for (const auto& [name, named] : names) {
    if (named == value) return std::string(name);
  }
  return "";
}

/// Upper-case name of an option's value, as in summaries and in Ceres: "DENSE_SCHUR".
template <typename Enum, size_t kSize>
std::string UpperName(Enum value, const NamedValue<Enum> (&names)[kSize]) {
  std::string name = NameOf(value, names);
  for (char& c : name) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
  return name;
}

}  // namespace bundle
