#pragma once

/// The passes over free points that covariances need, by the kernels of the elimination
/// (schur/kernels/survey_points.h, point_covariances.h): several observations at a time, where a
/// PointAssembler takes them one by one.

#include <cstdint>
#include <vector>

#include "core/covariance/free_gauge.h"
#include "core/covariance/gauge_sums.h"
#include "core/linear/block_structure.h"
#include "core/schur/kernels/kernels.h"
#include "core/schur/schur_problem.h"

namespace bundle {

class PointPasses {
 public:
  /// Keeps a reference to the problem, which has been linearised.
  PointPasses(const SchurProblem& schur, int num_threads);

  struct Found {
    double squares = 0;         ///< sum of squared residuals
    int64_t num_residuals = 0;  ///< counted ones
    double decrease = 0;        ///< sum 1/2 g^T V^-1 g
    std::vector<int> unclear;   ///< free points that are not in these sums, ascending
  };
  /// Sums over all points whose V is clearly regular; for `gauge` as well, unless it is nullptr.
  Found Survey(GaugeSums* gauge) const;

  /// The covariances of free points with observations, but those with very many, at `to`, 9 numbers
  /// each in the order of the problem, on all threads. `values` are the covariances of the camera
  /// parameters, blocks of `structure`, under the constraints of `gauge`; nullptr: there are none.
  void FindCovariances(const BlockStructure& structure, const std::vector<double>& values,
                       const FreeGauge* gauge, double* to) const;

 private:
  /// A block of an image in the columns of its record.
  struct RecordBlock {
    int block = -1;
    int size = 0;
    std::vector<int> column;  ///< column per unknown; empty: `map` says
    int first = -1;           ///< column of the first unknown, where the others follow it
    std::vector<double> map;  ///< record's columns x size, row-major
  };

  int NumColumns(int image) const { return schur_.input().image_columns[image]; }
  int Width(int image) const;
  void FillMoves(const GaugeSums& gauge, std::vector<double>* images,
                 std::vector<uint8_t>* moves_along) const;
  void AddEliminated(const std::vector<double>& of_images, GaugeSums* gauge, int thread) const;
  static void AddPlain(const BlockStructure& structure, const std::vector<double>& values,
                       const RecordBlock& rows, const RecordBlock& columns, int width, double* to);
  /// Adds the covariance of two images' columns, NumColumns(a) rows of Width(b).
  void FillPair(const BlockStructure& structure, const std::vector<double>& values, int a, int b,
                double* to) const;

  const SchurProblem& schur_;
  const int num_threads_;
  std::vector<std::vector<RecordBlock>> blocks_;  ///< per image
};

}  // namespace bundle
