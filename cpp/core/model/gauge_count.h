#pragma once

/// Motions of the world that change no image (gauge_count.cpp).

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/factors/reprojection.h"
#include "core/factors/rig_pose.h"
#include "core/interface/adjustment_problem.h"
#include "core/model/free_parameters.h"

namespace bundle {

class FreeMotions {
 public:
  /// Keeps references to both, which must not change during its lifetime.
  FreeMotions(const AdjustmentProblem& problem, const FreeParameters& free);

  /// Degrees of freedom of the gauge.
  int Degrees() const;
  /// Basis of the possible motions: similarities of the world together with motions of refined
  /// sensors, and motions of sensors on their rigs alone. Orthonormal columns, in radians, units of
  /// the scene and of scale.
  Eigen::MatrixXd Basis() const;
  /// Poses by which images with observations move: those of images, of frames, then of refined
  /// sensors.
  std::vector<int> Poses() const;

  /// Largest change of a pose number of an image or a frame by a motion of norm 1.
  double LongestMove() const { return longest_move_; }

  /// Changes of (w, t) of a pose by motions, one row each, in radians and units of the scene.
  struct PoseMoves {
    Eigen::MatrixXd chart;     ///< in the solver's coordinates
    Eigen::MatrixXd centered;  ///< with t about the centre of the scene
  };
  /// `motions`: combinations of the basis, one per column.
  PoseMoves MovesOf(int pose, const Eigen::MatrixXd& motions) const;

 private:
  /// Equations of the images of a frame, or of an image alone, in columns of W.
  struct Equations {
    Eigen::MatrixXd wanted;
    std::vector<int> columns;
  };

  void FindScene();
  double DistanceOfSomePoint() const;
  PoseState StartOf(int pose) const;
  PoseState Centered(int pose) const;
  Eigen::Matrix<double, 6, 6> ChartMap(int pose, const PoseState& centered) const;
  Eigen::MatrixXd FreeColumns(Eigen::Matrix<double, 6, 6> map, uint8_t bits) const;
  uint8_t BitsOf(int pose) const;
  RigPose OnRig(int image, const PoseState& own, PoseState* on_rig) const;
  Equations EquationsOf(int pose, const std::vector<int>& images) const;
  void AddImages(int pose, const std::vector<int>& images);
  void AddHeldPoints();
  void Add(const Eigen::MatrixXd& rows, const std::vector<int>& columns);
  void Factorize();
  Eigen::MatrixXd Scaled(int first) const;

  const AdjustmentProblem& problem_;
  const FreeParameters& free_;
  std::vector<int> images_;  ///< with observations
  std::vector<int> poses_;   ///< poses by which these images move, in the order of images
  std::vector<std::vector<int>> moving_;  ///< the images that move by each of poses_
  std::vector<int> first_column_;         ///< per sensor, after the columns of d
  int num_sensor_columns_ = 0;
  Eigen::Vector3d centre_;
  double size_ = 1;
  double longest_move_ = 0;
  Eigen::MatrixXd rows_;  ///< W: a triangle, and rows below it up to num_rows_
  Eigen::Index num_rows_ = 0;
  Eigen::VectorXd squares_;  ///< squared norms of the columns before the projection
};

/// Counts the unobservable degrees of freedom that `free` leaves: at most seven, rotation,
/// translation and scale of the world.
int CountGaugeDegrees(const AdjustmentProblem& problem, const FreeParameters& free);

}  // namespace bundle
