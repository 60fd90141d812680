#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/interface/options.h"
#include "core/linear/block_structure.h"

namespace bundle::fused {

/// An order in which to eliminate the blocks of S, and what its Cholesky factor then costs.
struct FillOrdering {
  std::string name;        ///< "natural", "amd" or "metis"
  std::vector<int> order;  ///< order[k]: the block eliminated as the k-th; an etree's postorder
  double entries = 0;      ///< of the factor
  double flops = 0;        ///< multiplications and additions; n^3 / 3 where S fills up
  double elimination_flops = 0;  ///< FactorCounts::flops, which reports speak of
};

/// The cheapest of the natural order, AMD's and METIS'.
FillOrdering FindFillOrdering(const BlockStructure& structure);

struct LinearSolution {
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
class LinearSolver {
 public:
  virtual ~LinearSolver() = default;

  /// x = S^-1 b. May overwrite the system. `scale` holds the Jacobi scaling of the columns: the
  /// unknowns that an iterative solver iterates on are x / scale, as in Ceres. `eta` is the forcing
  /// term of an iterative solver; the others ignore it.
  virtual LinearSolution Solve(BlockSystem* system, const std::vector<double>& scale, double eta,
                               double* x) = 0;

  /// True if it reads BlockSystem::camera_diagonal.
  virtual bool NeedsCameraDiagonal() const { return false; }
  /// True if it reads BlockSystem::gauge_directions.
  virtual bool NeedsGaugeDirections() const { return false; }

  virtual FactorStatistics factor_statistics() const { return {}; }
};

/// LAPACK's Cholesky factorisation; takes a dense structure.
std::unique_ptr<LinearSolver> MakeDenseSolver(const BlockStructure& structure, int num_threads);

/// A supernodal Cholesky factorisation, analysed once. `structure` is a sparse one whose blocks
/// stand in the order of the elimination, which `ordering` counted; it then says where the solver
/// wants their values, in place of its factor.
std::unique_ptr<LinearSolver> MakeSparseSolver(const FillOrdering& ordering, int num_threads,
                                               BlockStructure* structure);

/// Preconditioned conjugate gradients, as Ceres' ITERATIVE_SCHUR runs them; takes a sparse
/// structure. `preconditioner` is one of kIdentity, kJacobi, kSchurJacobi,
/// kSchurPowerSeriesExpansion and kTwoLevel.
std::unique_ptr<LinearSolver> MakeIterativeSolver(const BlockStructure& structure,
                                                  PreconditionerType preconditioner,
                                                  int num_threads);

}  // namespace bundle::fused
