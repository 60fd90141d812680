#pragma once

/// Sums over the points for the free similarities of the world (free_gauge.h): products of J and of
/// the reduced system with all seven similarities, computed in the first pass over the points.
///
/// Let the columns of N be the derivatives of all free parameters w.r.t. the similarities, about
/// the centre of the scene. The sums are J N, as the triangle of its QR factorisation, the squares
/// of the two parts of its rows, and, with Y_p = W_p V_p^-1 (point_blocks.h),
///
///   sum Y_p N_p,     sum N_p^T V_p^-1 N_p,     sum N_p^T N_p,
///
/// where the last three leave out points without parallax (free_gauge.h).
///
/// For combinations N T of the seven similarities, multiply the same sums by T.

#include <Eigen/Core>
#include <vector>

#include "core/covariance/observation_rows.h"
#include "core/covariance/point_blocks.h"
#include "core/interface/adjustment_problem.h"
#include "core/model/camera_states.h"
#include "core/model/gauge.h"
#include "core/model/parameter_layout.h"
#include "core/schur/kernels/kernels.h"

namespace bundle {

inline constexpr int kSimilarities = kNumGaugeDirections;
using SimilarityRow = Eigen::Matrix<double, 1, kSimilarities>;
using SimilaritySquare = Eigen::Matrix<double, kSimilarities, kSimilarities>;

/// J N as the triangle of its QR factorisation, and the squares of the two parts of its rows, by
/// cameras and by points. N^T J^T J N alone would lose half of the digits.
class GaugeTriangle {
 public:
  void Add(const SimilarityRow& by_cameras, const SimilarityRow& by_points);
  /// Adds rows that are zero, given the squares of their parts.
  void AddZeros(const SimilarityRow& parts) { parts_ += parts; }
  void Add(const GaugeTriangle& other);
  SimilaritySquare Triangle();
  const SimilarityRow& parts() const { return parts_; }

 private:
  static constexpr int kRows = 128;
  void Fold();

  Eigen::Matrix<double, kRows, kSimilarities> rows_ =
      Eigen::Matrix<double, kRows, kSimilarities>::Zero();
  SimilarityRow parts_ = SimilarityRow::Zero();
  int count_ = 0;
};

/// Derivatives of points and of the unknowns of a layout with respect to the similarities.
class SimilarityMoves {
 public:
  SimilarityMoves(const AdjustmentProblem& problem, const ParameterLayout& layout,
                  const CameraStates& states);

  int num_unknowns() const { return num_unknowns_; }
  SimilarityRow OfUnknown(int unknown) const {
    return Eigen::Map<const SimilarityRow>(&cameras_[size_t(unknown) * kSimilarities]);
  }
  /// Derivatives of all numbers of an image's pose, free or constant: kPoseSize rows.
  Eigen::Matrix<double, kPoseSize, kSimilarities> OfPose(const PoseState& pose) const;
  const double* center() const { return center_; }
  double size() const { return size_; }
  /// Three rows, one per coordinate of the point.
  Eigen::Matrix<double, 3, kSimilarities> OfPoint(int point) const;

 private:
  const AdjustmentProblem& problem_;
  int num_unknowns_;
  double center_[3];
  double size_;
  std::vector<double> cameras_;  ///< unknowns x 7, row-major
};

class GaugeSums {
 public:
  /// Keeps references to the problem and the layout.
  GaugeSums(const AdjustmentProblem& problem, const ParameterLayout& layout,
            const CameraStates& states, int num_threads);

  /// Adds a free point, on one of the threads. A point without parallax contributes only its rows
  /// of J N.
  void AddPoint(int point, const PointBlocks& blocks, const PointAssembler& rows, int thread);
  /// Adds the sums of a pass over many points, and the eliminated part of its images. Its rows of J
  /// N are not included; AddRow is called for these.
  void Add(const PointSurvey& survey, int thread);
  /// Adds a row of J N in two parts of kMoves numbers: by the images' unknowns, and by the point.
  void AddRow(const double* by_images, const double* by_point, int thread);
  /// Adds a contribution to sum Y_p N_p: kMoves numbers, for one unknown.
  void AddEliminated(int unknown, const double* row, int thread);
  /// Adds up the sums of the threads. Call last.
  void Finish();

  const SimilarityMoves& moves() const { return moves_; }
  /// The rows of J N of an observation whose point is not eliminated.
  void AddObservation(const ObservationRows& rows, GaugeTriangle* triangle) const;

  const GaugeTriangle& triangle() const { return total_.triangle; }
  /// sum Y_p N_p, unknowns x 7, row-major.
  const std::vector<double>& eliminated() const { return total_.eliminated; }
  const SimilaritySquare& weighted() const { return total_.weighted; }  ///< sum N_p^T V^-1 N_p
  const SimilaritySquare& squares() const { return total_.squares; }    ///< sum N_p^T N_p

 private:
  struct Sums {
    GaugeTriangle triangle;
    std::vector<double> eliminated;
    SimilaritySquare weighted = SimilaritySquare::Zero(), squares = SimilaritySquare::Zero();
  };

  SimilarityRow ByBlocks(const ObservationRows& rows, int row, int first, int last) const;

  const ParameterLayout& layout_;
  const SimilarityMoves moves_;
  std::vector<Sums> of_thread_;
  Sums total_;
};

}  // namespace bundle
