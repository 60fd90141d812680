#pragma once

/// Information on some images and cameras of a problem after everything else is marginalised.
///
/// Let b be the kept unknowns, and a all other free unknowns except the points. In the reduced
/// camera system (reduced_system.h), the points are already eliminated. The Schur complement of a,
///
///   Lambda = S_bb - S_ba S_aa^-1 S_ab,        eta = b_b - S_ba S_aa^-1 b_a,
///
/// is the information of all factors of the problem about b. Their cost, minimised over all other
/// unknowns, is 1/2 d^T Lambda d - eta^T d and a constant, to second order. Observations with a
/// loss have its weights at the problem's own values, as in the solvers.
///
/// S_aa is factorised once. Some parts of a may have no or only a loose connection to b, for
/// instance a component of images that shares only a camera with the others. Such parts may rotate,
/// move and scale: S_aa n = 0. As S is positive semidefinite, S_ba n = 0, too: free motions have no
/// effect, and any generalised inverse can be used. If a pivot is close to rounding errors, S_aa +
/// D is factorised, with D a diagonal kDamping times that of J^T J, and
///
///   X <- X + (S_aa + D)^-1 (S_ab - S_aa X)
///
/// is repeated until the residual stops decreasing. Along a direction with the scaled eigenvalue s,
/// the error decreases by D / (s + D) per repetition. Null directions stay at rounding errors.
///
/// Lambda and eta are transformed to the tangent coordinates of variables in a factor graph
/// (derived in problem_factors.h). For a pose T, which moves to T Exp(phi, rho), these are about a
/// centre c of the scene,
///
///   w = R phi,        t' = R (rho - c x phi).

#include <vector>

#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"

namespace bundle {

/// Indices in the problem's arrays. The tangent coordinates are in this order: six per image (with
/// a pose of its own), six per frame, and all parameters of each camera's model.
struct KeptVariables {
  std::vector<int> images;
  std::vector<int> frames;
  std::vector<int> cameras;
};

/// The number of tangent coordinates.
int TangentSize(const KeptVariables& kept, const AdjustmentProblem& problem);

struct RestInformation {
  std::vector<double> lambda;  ///< n x n, exactly symmetric; rows of constant parameters are zero
  std::vector<double> eta;     ///< n
  int num_eliminated = 0;      ///< number of eliminated unknowns of images and cameras
  int num_points = 0;          ///< number of eliminated points
  int num_null_points = 0;     ///< number of these points with an undetermined direction
  bool is_regular = true;      ///< false: the eliminated part has free motions, as above
};

/// The problem must be valid, without ties and without partly constant poses. Throws InputError as
/// ReducedSystem does, if the memory does not suffice, or if S_aa cannot be factorised.
RestInformation MarginalizeRest(const AdjustmentProblem& problem, const SolveOptions& options,
                                const KeptVariables& kept);

/// The similarities of the world that change no residual (free_gauge.h): n x degrees, row-major, in
/// the tangent coordinates of the kept variables.
struct FreeSimilarities {
  int degrees = 0;
  std::vector<double> rows;
};
FreeSimilarities FindFreeSimilarities(const AdjustmentProblem& problem, const SolveOptions& options,
                                      const KeptVariables& kept);

}  // namespace bundle
