#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/fused/reduced/fill_ordering.h"
#include "core/fused/reduced/reduced_system.h"
#include "core/solve/options.h"

namespace bundle::fused {

struct ReducedSolution {
  enum class Status {
    kSuccess,  ///< also where an iterative solver stopped at its limit, as in Ceres
    kFailure,  ///< not positive definite, or not finite: more damping may help
    kFatal,    ///< nothing will help, such as no memory
  };
  Status status = Status::kSuccess;
  int num_iterations = 1;  ///< of conjugate gradients; 1 for a factorisation, as in Ceres
  std::string message;
};

/// What a factorisation costs, for reports.
struct FactorStatistics {
  std::string ordering;  ///< "natural", "amd" or "metis"; empty without a factorisation
  double entries = 0;    ///< of the factor, without the zeros that supernodes add
  double flops = 0;      ///< FactorCounts::flops
  double predicted = 0;  ///< entries, by the ordering
  double stored = 0;     ///< entries with the zeros, diagonal blocks by their lower triangle
};

/// Solves the reduced camera system of one structure again and again.
class ReducedSolver {
 public:
  virtual ~ReducedSolver() = default;

  /// x = S^-1 b. May overwrite the system. `scale` holds the Jacobi scaling of the columns: the
  /// unknowns that an iterative solver iterates on are x / scale, as in Ceres. `eta` is the forcing
  /// term of an iterative solver; the others ignore it.
  virtual ReducedSolution Solve(ReducedSystem* system, const std::vector<double>& scale, double eta,
                                double* x) = 0;

  /// True if it reads ReducedSystem::camera_diagonal.
  virtual bool NeedsCameraDiagonal() const { return false; }
  /// True if it reads ReducedSystem::similarities.
  virtual bool NeedsSimilarities() const { return false; }

  virtual FactorStatistics factor_statistics() const { return {}; }
};

/// LAPACK's Cholesky factorisation; takes a dense structure.
std::unique_ptr<ReducedSolver> MakeDenseSolver(const ReducedStructure& structure, int num_threads);

/// A supernodal Cholesky factorisation, analysed once. `structure` is a sparse one whose blocks
/// stand in the order of the elimination, which `ordering` counted; it then says where the solver
/// wants their values, in place of its factor.
std::unique_ptr<ReducedSolver> MakeSparseSolver(const FillOrdering& ordering, int num_threads,
                                                ReducedStructure* structure);

/// Preconditioned conjugate gradients, as Ceres' ITERATIVE_SCHUR runs them; takes a sparse
/// structure. `preconditioner` is one of kIdentity, kJacobi, kSchurJacobi,
/// kSchurPowerSeriesExpansion and kTwoLevel.
std::unique_ptr<ReducedSolver> MakeIterativeSolver(const ReducedStructure& structure,
                                                   PreconditionerType preconditioner,
                                                   int num_threads);

}  // namespace bundle::fused
