#pragma once

/// Sums over points without rounding that depends on their order.
///
/// The reduced camera system is a sum over points, and its last digits depend on the order of
/// summation. For direct solvers this hardly matters. Hundreds of iterations of conjugate gradients
/// amplify it: they lose orthogonality in different places, and end with costs that differ by 1e-6.
/// So their sums are made on a grid. Every number is rounded to a multiple of a spacing h before it
/// is added. Sums of multiples are exact, and therefore the same in any order, for any division
/// among chunks, threads and ranks.
///
/// Rounding costs no extra operation. Doubles in [2^e, 2^(e+1)) have the spacing h = 2^(e-52). A
/// sum that starts at 3/2 2^e instead of 0, and stays within a quarter of 2^(e+1) of it, rounds
/// each term to the grid. (J. Demmel, H. D. Nguyen: Fast Reproducible Floating-Point Summation,
/// ARITH 2013.) A term half way between two multiples is rounded to the even one, which may depend
/// on the order. A product that is added by a fused multiply-add has too many digits for that to
/// happen. Without such instructions, the term of a point or of an observation is rounded first,
/// and its last bit is then set to 1. As a term is at most s_a s_b / 2 (below), this bit is at most
/// an eighth of the spacing, so the term is not half way.
///
/// The required bound is Cauchy-Schwarz. A point adds u_a^T P u_b or u_a^T u_b to entry (a, b) of S
/// and subtracts u_a^T P u_b. Here u_a are the rows of the Jacobian's column a that see the point,
/// and P is a matrix between 0 and the identity (kernels/eliminate_point.h). Over any subset of
/// these terms,
///
///   |sum u_a^T P u_b| <= sqrt(sum |u_a|^2) sqrt(sum |u_b|^2) <= ||J e_a|| ||J e_b||,
///
/// so that the sum of both kinds is at most twice that, and at most s_a s_b with a power of two
/// s_a >= sqrt(2) ||J e_a|| for each column. Likewise |J^T r| <= s_a t for the residuals' norm
/// ||r|| <= t. A grid is therefore given by s and t: entry (a, b) starts at
/// 3 s_a s_b and has the spacing 2^-51 s_a s_b.
///
/// s and t must be known before the sums are made. They come from the previous linearisation, with
/// a margin to grow. If a column exceeds its margin, the pass is repeated. The norms depend on
/// rounding errors, but s and t use only their exponents and are therefore the same for any order.
/// The margin costs digits: the error of an entry is 2^-52 s_a s_b per term, 2^5 times the error
/// without a grid. Conjugate gradients do not need these digits, because they stop at a tenth of
/// the residual.

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/linear/block_structure.h"
#include "core/schur/assembly/assembler.h"
#include "core/schur/elimination_plan.h"
#include "core/schur/kernels/kernels.h"

namespace bundle {

class SumGrid {
 public:
  /// Keeps a reference to the input. The assembler must have no maps, because maps would round the
  /// sums of a chunk again.
  SumGrid(const EliminationInput& input, const Assembler& assembler,
          const BlockStructure& structure, int num_parts);

  /// The grid for columns with about these squared norms and residuals of this cost.
  void Choose(const std::vector<double>& squared_norms, double cost);

  /// True if columns with these squared norms and residuals of this cost fit the grid. Also true
  /// for infinite numbers and NaN, which fit no grid.
  bool Fits(const std::vector<double>& squared_norms, double cost) const;

  /// Removes the grid until the next Choose.
  void Forget() { is_chosen_ = false; }
  bool is_chosen() const { return is_chosen_; }

  /// Adds the start values of the sums of a chunk.
  void Start(const Chunk& chunk, ChunkSum* sum) const {
    Add(chunk, 1, sum);
    sum->last_bit = 1;
  }
  /// Subtracts the start values; the differences are multiples of the spacings.
  void Finish(const Chunk& chunk, ChunkSum* sum) const { Add(chunk, -1, sum); }

 private:
  void Add(const Chunk& chunk, double sign, ChunkSum* sum) const;

  const EliminationInput& input_;
  size_t stride_;                  ///< stride of a part in column_ and scale_
  std::vector<int32_t> column_;    ///< column of the layout, per column of each part; -1: none
  std::vector<double> scale_;      ///< s of each part's columns; 1 without a column
  std::vector<double> of_column_;  ///< s of each column of the layout
  double residual_ = 0;            ///< t
  bool is_chosen_ = false;
};

}  // namespace bundle
