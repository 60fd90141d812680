#pragma once

/// The passes over free points for covariances, by the kernels of the elimination
/// (schur/kernels/survey_points.h, point_covariances.h, point_leverages.h, point_movements.h). They
/// process several observations at a time; PointAssembler processes one at a time.

#include <cstdint>
#include <functional>
#include <vector>

#include "core/covariance/free_gauge.h"
#include "core/covariance/gauge_sums.h"
#include "core/linear/block_structure.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/schur_problem.h"

namespace bundle {

class PointPasses {
 public:
  /// Keeps a reference to the problem, which must be linearised.
  PointPasses(const SchurProblem& schur, int num_threads);

  struct Found {
    double squares = 0;         ///< sum of squared residuals
    int64_t num_residuals = 0;  ///< number of residuals that count
    double decrease = 0;        ///< sum 1/2 g^T V^-1 g
    std::vector<int> unclear;   ///< free points left out of these sums, ascending
  };
  /// Sums over all points whose V is clearly regular; also the sums for `gauge`, unless it is
  /// nullptr.
  Found Survey(GaugeSums* gauge) const;

  /// Writes the covariances of free points with observations to `to`, 9 numbers each in the order
  /// of the problem, on all threads. Leaves out points with very many observations. `values` are
  /// the covariances of the camera parameters, blocks of `structure`, under the constraints of
  /// `gauge`; nullptr: without constraints.
  void FindCovariances(const BlockStructure& structure, const BlockValues& values,
                       const FreeGauge* gauge, double* to) const;

  /// Takes the leverage of an observation of the problem; called on all threads.
  using LeverageVisitor =
      std::function<void(int64_t observation, const ObservationLeverage& found)>;
  /// Visits the observations that count, of free points, but not of points with very many. `values`
  /// nullptr: without h; `adjoint`: by unknown, nullptr: zeros. `covariances` of these points as in
  /// FindCovariances, nullptr: not needed.
  void FindLeverages(const BlockStructure& structure, const BlockValues* values,
                     const double* adjoint, double* covariances,
                     const LeverageVisitor& visit) const;

  /// Takes V^-1 of a point (9 numbers) and Y^T X, three rows of whole quads; called on all threads.
  using MovementVisitor =
      std::function<void(int point, const double* inverse, const double* rows, int thread)>;
  /// Visits the marked free points with observations, but not those with very many. `by_unknown`:
  /// X, `num_quads` quads per unknown, at most Kernels::kMostMoved numbers.
  void FindMovements(const double* by_unknown, int num_quads, const std::vector<uint8_t>& is_wanted,
                     const MovementVisitor& visit) const;

 private:
  /// A block of the layout in the columns of a part.
  struct ColumnBlock {
    int block = -1;
    int size = 0;
    std::vector<int> column;  ///< column per unknown; empty: use `map`
    int first = -1;           ///< column of the first unknown if the columns are consecutive
    std::vector<double> map;  ///< columns of the part x size, row-major
  };

  int NumColumns(int part) const { return schur_.input().part_rows[part]; }
  int Width(int part) const { return 4 * schur_.input().part_quads[part]; }
  /// Calls visit(block, number of the first column of its part in the record) for an image.
  template <typename Visit>
  void ForBlocksOf(int image, const Visit& visit) const;
  void FillMoves(const GaugeSums& gauge, std::vector<double>* images,
                 std::vector<uint8_t>* moves_along) const;
  void AddEliminated(const std::vector<double>& of_images, GaugeSums* gauge, int thread) const;
  static void AddPlain(const BlockStructure& structure, const BlockValues& values,
                       const ColumnBlock& rows, const ColumnBlock& columns, int width, double* to);
  /// Adds the covariance of two parts' columns, NumColumns(a) rows of Width(b).
  void FillPair(const BlockStructure& structure, const BlockValues& values, int a, int b,
                double* to) const;
  void CopyToPoints(const Chunk& chunk, int64_t count, const std::vector<double>& from,
                    double* to) const;
  std::vector<double> ByPart(const double* by_unknown, int width) const;
  /// Memory of a thread, reused from chunk to chunk.
  struct Room;
  /// Fills the blocks of each chunk with free points, and calls visit(chunk, last free point,
  /// room), on all threads. `values` nullptr: no blocks. `both_ways`: also transposed
  /// (LeverageInput).
  template <typename Visit>
  void ForChunks(const BlockStructure& structure, const BlockValues* values, bool both_ways,
                 const Visit& visit) const;

  const SchurProblem& schur_;
  const int num_threads_;
  std::vector<std::vector<ColumnBlock>> blocks_;  ///< per part
};

}  // namespace bundle
