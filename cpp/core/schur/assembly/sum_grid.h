#pragma once

/// Sums over points without rounding that depends on their order.
///
/// The reduced camera system is a sum over points, and rounding makes its last digits a matter of
/// who was added to whom first. Direct solvers hardly notice. Hundreds of conjugate gradients do:
/// they lose orthogonality where rounding says, and end 1e-6 of the cost apart. So their sums are
/// made on a grid. Every number is rounded to a multiple of a spacing h before it is added; sums of
/// multiples are exact, and therefore the same in any order, for any division among chunks, threads
/// and ranks.
///
/// Rounding costs nothing: doubles in [2^e, 2^(e+1)) have the spacing h = 2^(e-52), so a sum that
/// starts at 3/2 2^e in place of 0 and stays within a quarter of 2^(e+1) of it rounds what is added
/// to the grid by itself. (J. Demmel, H. D. Nguyen: Fast Reproducible Floating-Point Summation,
/// ARITH 2013.) What lies half way between two multiples goes to the even one and may depend on the
/// order still: products of Jacobians have too many digits for that to happen.
///
/// The bound that this needs is Cauchy's and Schwarz's. What a point adds to entry (a, b) of S is
/// u_a^T P u_b, with u_a the rows of the Jacobian's column a that see the point and P a matrix
/// between 0 and the identity (kernels/eliminate_point.h). Over any of the points,
///
///   |sum u_a^T P u_b| <= sqrt(sum |u_a|^2) sqrt(sum |u_b|^2) <= ||J e_a|| ||J e_b|| <= s_a s_b,
///
/// with a power of two s_a >= ||J e_a|| for each column, and likewise |J^T r| <= s_a t for the
/// residuals' norm ||r|| <= t. A grid is therefore given by s and t: entry (a, b) starts at
/// 3 s_a s_b and has the spacing 2^-51 s_a s_b.
///
/// s and t have to be known before the sums are made. They are those of the linearisation before,
/// with room to grow; where a column outgrows its room, the pass is made again. Norms before are
/// known to rounding only, but of s and t the exponent counts, so that they are the same for any
/// order, too. The room costs digits: an entry is wrong by 2^-52 s_a s_b a term, five bits more
/// than without. Conjugate gradients, which stop at a tenth of the residual, do not miss them.

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
  /// Keeps a reference to the input. The assembler has no maps: these would round what a chunk has
  /// summed up once more.
  SumGrid(const EliminationInput& input, const Assembler& assembler,
          const BlockStructure& structure, int num_images);

  /// The grid for columns of about these squared norms and residuals of this cost.
  void Choose(const std::vector<double>& squared_norms, double cost);

  /// True if columns of these squared norms and residuals of this cost fit. Also of numbers that no
  /// grid would fit: infinite ones, and those that are not a number.
  bool Fits(const std::vector<double>& squared_norms, double cost) const;

  /// Forgets the grid: there is none until Choose.
  void Forget() { is_chosen_ = false; }
  bool is_chosen() const { return is_chosen_; }

  /// Adds what the sums of a chunk start at.
  void Start(const Chunk& chunk, ChunkSum* sum) const { Add(chunk, 1, sum); }
  /// Takes it away: what is left are multiples of the spacings.
  void Finish(const Chunk& chunk, ChunkSum* sum) const { Add(chunk, -1, sum); }

 private:
  void Add(const Chunk& chunk, double sign, ChunkSum* sum) const;
  int WidthOf(int image) const;

  const EliminationInput& input_;
  size_t stride_;                  ///< stride of an image in column_ and scale_
  std::vector<int32_t> column_;    ///< column of the layout, per column of each image; -1: none
  std::vector<double> scale_;      ///< s of each image's columns
  std::vector<double> of_column_;  ///< s of each column of the layout
  double residual_ = 0;            ///< t
  bool is_chosen_ = false;
};

}  // namespace bundle
