#pragma once

/// Normal equations of a least-squares problem over pairs of nodes, with a block per node and one
/// per edge, solved once.

#include <cstdint>
#include <vector>

namespace bundle {

/// H x = b, H symmetric positive definite with square blocks of one size. All row-major.
struct EdgeSystem {
  int block_size = 0;
  int64_t num_nodes = 0;
  int64_t num_edges = 0;
  const int32_t* edges = nullptr;    ///< num_edges x 2: two different nodes, in any order
  const double* diagonal = nullptr;  ///< num_nodes blocks; only the lower triangle is read
  const double* between =
      nullptr;  ///< num_edges blocks H(first, second); blocks of the same pair add up
  const double* rhs = nullptr;  ///< num_nodes x block_size
};

/// Returns x, num_nodes x block_size; empty if H is not positive definite.
///
/// Throws std::bad_alloc, and Interrupted.
std::vector<double> SolveEdgeSystem(const EdgeSystem& system);

}  // namespace bundle
