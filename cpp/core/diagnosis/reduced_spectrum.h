#pragma once

/// Spectrum of the reduced camera system S: its null space, the part of the null space that is the
/// gauge, and its weakest directions (derived in reduced_spectrum.cpp).

#include <cstdint>
#include <string>
#include <vector>

#include "core/covariance/reduced_system.h"
#include "core/interface/adjustment_problem.h"
#include "core/interface/options.h"
#include "core/interface/summary.h"
#include "core/model/unknown_names.h"

namespace bundle {

/// Directions are in units of the unknowns, d_j = 1 / sqrt(S_jj): the standard deviation of an
/// unknown if all others were known, for residuals of standard deviation 1. S is then diag(d) S
/// diag(d), with ones on its diagonal.
struct ReducedSpectrum {
  std::vector<UnknownName> unknowns;
  std::vector<double> scale;    ///< d; 0 for undetermined unknowns
  std::vector<uint8_t> unseen;  ///< 1 for undetermined unknowns
  std::vector<NullPoint> null_points;
  std::vector<Warning> warnings;

  int expected_nullity = 0;      ///< result of CountGaugeDegrees, for the world as one piece
  int nullity = 0;               ///< nullity of S, plus similarities that move no camera
  int num_gauge = 0;             ///< similarities of the world that no observation sees
  bool nullity_is_exact = true;  ///< false: more null directions exist than are searched for

  /// Null directions beyond the similarities of the pieces and the unseen unknowns, orthonormal;
  /// unknowns x num_null_directions, row-major.
  std::vector<double> null_directions;
  int num_null_directions = 0;
  double max_null_eigenvalue = 0;  ///< largest eigenvalue that counts as zero
  /// The smallest nonzero eigenvalues, ascending, and their directions, orthonormal, in the same
  /// layout.
  std::vector<double> eigenvalues;
  std::vector<double> directions;

  double max_eigenvalue = 0;  ///< largest eigenvalue of the scaled S
  /// Ratio of the largest to the smallest nonzero eigenvalue of the unscaled S; NaN if unknown.
  double condition_number_unscaled = 0;

  std::string failure;      ///< a sentence if S could not be factorised; else ""
  int failed_unknown = -1;  ///< the unknown at which it failed, if known
};

/// `image_piece`: for each image, the number of its piece of the world, as connected by points; -1
/// for images without observations. The problem must be valid, with known camera models.
///
/// Throws InputError as ReducedSystem does.
ReducedSpectrum FindReducedSpectrum(const AdjustmentProblem& problem, const SolveOptions& options,
                                    const int32_t* image_piece, int num_modes);

}  // namespace bundle
