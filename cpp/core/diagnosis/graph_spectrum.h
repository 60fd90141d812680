#pragma once

/// Condition of the normal equations of a pose graph (derived in graph_spectrum.cpp).

#include <vector>

#include "core/pose_graph/pose_graph.h"

namespace bundle {

struct GraphSpectrum {
  std::vector<double> eigenvalues;  ///< the lowest of the scaled system, ascending
  double max_eigenvalue = 0;        ///< largest eigenvalue of the scaled system
  double condition_number = 0;      ///< condition of the scaled system; NaN without a free pose
  double condition_number_unscaled = 0;
};

/// At the graph's poses, constant ones excluded. `null_directions`: num_poses x d rows by tangent
/// coordinates, row-major, with `num_null` columns. They are directions that the edges do not
/// determine, zero at held poses; they are left out, too.
GraphSpectrum FindGraphSpectrum(const PoseGraph& graph, const double* null_directions, int num_null,
                                int num_threads);

}  // namespace bundle
