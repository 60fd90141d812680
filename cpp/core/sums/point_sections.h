#pragma once

/// Sections of the points: what no division among ranks and no chunk cuts.
///
/// A sum over points has the same bits on one rank and on several if it is made of the same parts.
/// So the points are cut once, by the problem alone: in the order of the first image that sees
/// them, then of the last, then of their indices, where the observations so far are k/K of all. A
/// rank has whole sections (bundle/ranks/partition.py) wherever N divides K, and the chunks of an
/// elimination plan end where sections do. What is added up over chunks is added up so that their
/// order hardly matters (twofold_sum.h).
///
/// Sections cost what the order of S would save: points that are sorted by the blocks of S, all of
/// them, add to S from its first column to its last. Where an image shares points with a few dozen
/// others, as on a street, the difference is a few percent. Where it does with hundreds, and S is
/// in another order than the images, adding to S takes twice as long, and sections are not used
/// (SchurSetup): such problems determine their unknowns well, and rounding does not grow.
///
/// K is a multiple of 12, which 1, 2, 3, 4, 6 and 12 divide, and grows with the problem. Where N
/// does not divide K, ranks have parts of sections, and bits are those of N ranks.

#include <cstdint>
#include <vector>

#include "core/problem/problem_view.h"

namespace bundle {

/// K, for so many observations.
int NumPointSections(int64_t num_observations);

/// The section of each point of a problem that is not divided.
std::vector<uint16_t> FindPointSections(const ProblemView& problem, int num_threads);

}  // namespace bundle
