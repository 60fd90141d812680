#pragma once

/// Condition of the normal equations of a pose graph (derived in graph_spectrum.cpp).

#include <vector>

#include "core/pose_graph/pose_graph.h"

namespace bundle {

struct GraphSpectrum {
  std::vector<double> eigenvalues;  ///< the lowest of the scaled system, ascending
  double max_eigenvalue = 0;        ///< likewise scaled
  double condition_number = 0;      ///< condition of the scaled system; NaN without a free pose
  double condition_number_unscaled = 0;
};

/// At the graph's poses, held ones left out. `null_directions`: num_poses x d rows by tangent
/// coordinates, row-major, `num_null` columns: directions that the edges leave open, zero at held
/// poses; they are left out, too.
GraphSpectrum FindGraphSpectrum(const PoseGraph& graph, const double* null_directions, int num_null,
                                int num_threads);

}  // namespace bundle
