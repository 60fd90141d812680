#pragma once

/// Sections of the points. A section is never divided among ranks or chunks.
///
/// A sum over points has the same bits on one rank and on several if it has the same partial sums.
/// So the points are divided into K sections that depend only on the problem. They are sorted by
/// the first image that sees them, then by the last, then by their indices. They are cut where the
/// cumulative number of observations reaches k/K of the total. Each of N ranks has complete
/// sections (python/bundle/solving/ranks/partition.py) if N divides K, and the chunks of an
/// elimination plan end with sections. The order of chunks has nearly no effect on sums over them
/// (double_double.h).
///
/// Sections cost time. Without sections, all points are sorted by their blocks of S, so that they
/// fill S from its first column to its last. If an image shares points with a few dozen others, as
/// on a street, the difference is a few percent. If it shares points with hundreds, and S is in
/// another order than the images, adding to S takes twice as long. Sections are then not used
/// (SchurSetup): such problems determine their unknowns well, and rounding errors do not grow.
///
/// K is a multiple of 12, which is divisible by 1, 2, 3, 4, 6 and 12, and grows with the problem.
/// If N does not divide K, sections are split among ranks, and the bits depend on N.

#include <cstdint>
#include <vector>

#include "core/scratch/large_vector.h"

namespace bundle {

class ThreadPool;

/// K for a number of observations.
int NumPointSections(int64_t num_observations);

/// Section of each point of a problem that is not divided among ranks. Observation i is of point
/// observation_point[i] in image observation_image[i]. `pool`: nullptr for this thread alone.
LargeVector<uint16_t> FindPointSections(int num_images, int num_points, int64_t num_observations,
                                        const int32_t* observation_image,
                                        const int32_t* observation_point, ThreadPool* pool);

}  // namespace bundle
