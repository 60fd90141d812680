#pragma once

/// Information on some images and cameras of a problem after everything else is marginalised.
///
/// Let b be the unknowns that are kept, a all others that are free but for the points. The reduced
/// camera system (reduced_system.h) has the points eliminated already; the Schur complement of a,
///
///   Lambda = S_bb - S_ba S_aa^-1 S_ab,        eta = b_b - S_ba S_aa^-1 b_a,
///
/// is the information that all factors of the problem hold of b: their cost, minimised over
/// everything else, is 1/2 d^T Lambda d - eta^T d and a constant, to second order. Observations
/// with a loss count with its weights at the problem's own values, as in the solvers.
///
/// S_aa is factorised once. Parts of a that are not connected to b, or only loosely (a component of
/// images that shares no more than a camera with the others), may turn, move and scale: S_aa n = 0.
/// As S is positive semidefinite, S_ba n = 0, too: free motions have no influence, and any
/// generalised inverse serves. If a pivot is close to rounding errors, S_aa + D is factorised, with
/// D a diagonal kDamping times that of J^T J, and
///
///   X <- X + (S_aa + D)^-1 (S_ab - S_aa X)
///
/// is repeated until the residual stops falling. A direction with the scaled eigenvalue s converges
/// by D / (s + D) per repetition, and null directions stay at rounding.
///
/// Lambda and eta go to the tangent coordinates of variables in a factor graph (problem_factors.h
/// derives them): of a pose T to T Exp(phi, rho) they are, about a centre c of the scene,
///
///   w = R phi,        t' = R (rho - c x phi).

#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"

namespace bundle {

/// Indices in the problem's arrays. Tangent coordinates stand in this order: six per image (of one
/// with a pose of its own), six per frame, and all parameters of each camera's model.
struct KeptVariables {
  std::vector<int> images;
  std::vector<int> frames;
  std::vector<int> cameras;
};

/// The number of tangent coordinates.
int TangentSize(const KeptVariables& kept, const AdjustmentProblem& problem);

struct RestInformation {
  std::vector<double> lambda;  ///< n x n, symmetric to the last bit; rows of what is held are zero
  std::vector<double> eta;     ///< n
  int num_eliminated = 0;      ///< unknowns of images and cameras that are gone
  int num_points = 0;          ///< points that are gone
  int num_null_points = 0;     ///< points among these with a direction that no residual determines
  bool is_regular = true;      ///< false: something of the eliminated part is free, as above
};

/// The problem is valid, without ties and without partly held poses. Throws InputError as
/// ReducedSystem does, if the memory does not suffice, or if S_aa cannot be factorised.
RestInformation MarginalizeRest(const AdjustmentProblem& problem, const SolveOptions& options,
                                const KeptVariables& kept);

/// The similarities of the world that change no residual (free_gauge.h): n x degrees, row-major, in
/// the tangent coordinates of what is kept.
struct FreeSimilarities {
  int degrees = 0;
  std::vector<double> rows;
};
FreeSimilarities FindFreeSimilarities(const AdjustmentProblem& problem, const SolveOptions& options,
                                      const KeptVariables& kept);

}  // namespace bundle
