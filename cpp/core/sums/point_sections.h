#pragma once

/// Sections of the points. Neither a division among ranks nor a chunk cuts a section.
///
/// A sum over points has the same bits on one rank and on several if it is made of the same parts.
/// So the points are cut once, by the problem alone: in the order of the first image that sees
/// them, then of the last, then of their indices, where the observations so far are k/K of all. A
/// rank has whole sections (solving/ranks/partition.py) wherever N divides K, and the chunks of an
/// elimination plan end where sections do. What is added up over chunks is added up so that their
/// order hardly matters (double_double.h).
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

namespace bundle {

/// K for a number of observations.
int NumPointSections(int64_t num_observations);

/// Section of each point of a problem that is not divided among ranks. Observation i is of point
/// observation_point[i] in image observation_image[i].
std::vector<uint16_t> FindPointSections(int num_images, int num_points, int64_t num_observations,
                                        const int32_t* observation_image,
                                        const int32_t* observation_point, int num_threads);

}  // namespace bundle
